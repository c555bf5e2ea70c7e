within Daest;
package Units "Units of physical quantities"
end Units;
