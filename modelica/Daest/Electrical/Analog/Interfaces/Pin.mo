within Daest.Electrical.Analog.Interfaces;
connector Pin "Pin of an electrical component"
  SI.ElectricPotential v "Potential at the pin";
  flow SI.Current i "Current flowing into the pin";
end Pin;
