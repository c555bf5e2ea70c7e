within Daest.Hydraulic;
package Sensors "Ideal sensors of level, pressure and flow"
end Sensors;
