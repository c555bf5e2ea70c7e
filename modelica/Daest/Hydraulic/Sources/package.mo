within Daest.Hydraulic;
package Sources "Pressure and flow sources"
end Sources;
