within Daest.Thermal.HeatTransfer;
package Celsius "Sources and sensors in degree Celsius; ports stay in kelvin"
end Celsius;
