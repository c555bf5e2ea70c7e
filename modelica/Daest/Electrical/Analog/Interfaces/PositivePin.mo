within Daest.Electrical.Analog.Interfaces;
connector PositivePin "Positive pin of an electrical component"
  SI.ElectricPotential v "Potential at the pin";
  flow SI.Current i "Current flowing into the pin";
end PositivePin;
