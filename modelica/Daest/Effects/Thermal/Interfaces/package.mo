within Daest.Effects.Thermal;
package Interfaces "Partial models of effects"
end Interfaces;
