within Daest.Effects;
package Amounts "Effects on amounts and concentrations that belong to no physical domain"
end Amounts;
