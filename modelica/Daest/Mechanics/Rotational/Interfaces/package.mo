within Daest.Mechanics.Rotational;
package Interfaces "Flanges and partial models"
end Interfaces;
