within Daest.Mechanics.Rotational;
package Sensors "Ideal sensors of motion and torque"
end Sensors;
