within Daest;
package Hydraulic "Incompressible liquid in open tanks and lines"
  import Daest.Units.SI;
  annotation(
    Documentation(info = "Ports carry the gauge pressure p (0 is the ambient) and the volume flow rate q into the
component."));
end Hydraulic;
