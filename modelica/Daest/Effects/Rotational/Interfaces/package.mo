within Daest.Effects.Rotational;
package Interfaces "Partial models of effects"
end Interfaces;
