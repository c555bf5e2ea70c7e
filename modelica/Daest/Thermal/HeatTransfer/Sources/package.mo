within Daest.Thermal.HeatTransfer;
package Sources "Temperature and heat sources"
end Sources;
