within Daest;
package Mechanics "Mechanical components"
end Mechanics;
