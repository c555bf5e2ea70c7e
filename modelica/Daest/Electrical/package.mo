within Daest;
package Electrical "Electrical components"
end Electrical;
