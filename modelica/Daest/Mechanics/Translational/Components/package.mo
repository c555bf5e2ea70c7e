within Daest.Mechanics.Translational;
package Components "Translational components"
end Components;
