within Daest.Terms;
model Inflow "Rate of change of a store that holds a known amount"
  input Real amount "Amount or concentration";
  Daest.Effects.Amounts.Interfaces.Port port "Port of the store";
  Real total "Sum of the rates into what is connected";
equation
  port.amount = amount;
  total = -port.inflow;
end Inflow;
