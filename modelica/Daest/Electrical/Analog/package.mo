within Daest.Electrical;
package Analog "Analog electrical circuits"
  import Daest.Units.SI;
end Analog;
