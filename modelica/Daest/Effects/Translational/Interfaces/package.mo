within Daest.Effects.Translational;
package Interfaces "Partial models of effects"
end Interfaces;
