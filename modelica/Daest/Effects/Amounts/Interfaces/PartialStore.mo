within Daest.Effects.Amounts.Interfaces;
partial model PartialStore "Effect on the balance of an amount"
  Port port "Store";
  Real x "Amount or concentration (= port.amount)";
  Real r "Rate at which the store gains (= -port.inflow)";
equation
  x = port.amount;
  port.inflow = -r;
end PartialStore;
