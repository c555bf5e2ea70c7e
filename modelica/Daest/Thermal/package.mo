within Daest;
package Thermal "Thermal components"
end Thermal;
