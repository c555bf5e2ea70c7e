within Daest.Thermal.HeatTransfer;
package Components "Storage and transport of heat"
end Components;
