within Daest.Electrical.Analog;
package Interfaces "Pins and partial models"
end Interfaces;
