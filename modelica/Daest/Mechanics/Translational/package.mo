within Daest.Mechanics;
package Translational "One-dimensional translational mechanics"
  import Daest.Units.SI;
end Translational;
