within Daest.Effects.Amounts;
package Interfaces "Connector and base of effects on amounts"
end Interfaces;
