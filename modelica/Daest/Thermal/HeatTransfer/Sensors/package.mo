within Daest.Thermal.HeatTransfer;
package Sensors "Ideal sensors of temperature and heat flow"
end Sensors;
