within Daest.Effects.Hydraulic;
model WideningTank "Tank that widens or narrows upwards"
  extends Interfaces.PartialPort;
  parameter Real k(unit = "m3/Pa2") = 1e-8 "Volume per pressure, per pressure"
    annotation(__Daest(estimate = true, role = "size", null = 0));
equation
  q = -k*p*der(p);
  annotation(
    __Daest(effect = true, attach = "connector", dynamic = true, of_store = true, law = "q = -k*p*der(p)"),
    Documentation(info = "Funnels, lying cylinders and walls that lean: the area of the surface grows with the
level. It stands at a tank of the model, whose area is then that at its bottom."));
end WideningTank;
