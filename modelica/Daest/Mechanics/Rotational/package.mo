within Daest.Mechanics;
package Rotational "One-dimensional rotational mechanics"
  import Daest.Units.SI;
end Rotational;
