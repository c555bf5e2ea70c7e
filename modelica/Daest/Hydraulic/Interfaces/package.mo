within Daest.Hydraulic;
package Interfaces "Hydraulic ports and partial models"
end Interfaces;
