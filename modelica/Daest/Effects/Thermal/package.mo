within Daest.Effects;
package Thermal "Effects on heat"
end Thermal;
