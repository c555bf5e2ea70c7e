within Daest.Mechanics.Translational;
package Interfaces "Flanges and partial models"
end Interfaces;
