within Daest.Effects.General;
package Interfaces "Bases of effects that need no domain"
end Interfaces;
