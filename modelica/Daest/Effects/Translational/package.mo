within Daest.Effects;
package Translational "Effects on bodies that move along a line"
end Translational;
