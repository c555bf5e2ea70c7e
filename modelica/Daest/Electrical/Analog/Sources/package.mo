within Daest.Electrical.Analog;
package Sources "Voltage and current sources"
end Sources;
