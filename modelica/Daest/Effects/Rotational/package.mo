within Daest.Effects;
package Rotational "Effects on shafts"
end Rotational;
