within Daest.Thermal;
package HeatTransfer "One-dimensional heat transfer with lumped elements"
  import Daest.Units.SI;
end HeatTransfer;
