within Daest.Mechanics.Rotational;
package Components "Rotational components"
end Components;
