within Daest.Effects.Signals;
package Interfaces "Partial models of effects"
end Interfaces;
