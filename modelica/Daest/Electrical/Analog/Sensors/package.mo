within Daest.Electrical.Analog;
package Sensors "Ideal sensors of voltage, current and potential"
end Sensors;
