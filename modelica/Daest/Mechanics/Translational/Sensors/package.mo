within Daest.Mechanics.Translational;
package Sensors "Ideal sensors of motion and force"
end Sensors;
