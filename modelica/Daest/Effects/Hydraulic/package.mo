within Daest.Effects;
package Hydraulic "Effects on liquids"
end Hydraulic;
