within Daest.Effects.Amounts.Interfaces;
connector Port "What a store holds, and at what rate it gains more"
  Real amount "Amount or concentration";
  flow Real inflow "Rate of change by what flows into the component";
end Port;
