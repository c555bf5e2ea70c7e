within Daest.Effects.Hydraulic;
package Interfaces "Partial models of effects"
end Interfaces;
