within Daest.Effects.Translational;
model CoggingForce "Force that repeats along the way"
  extends Interfaces.PartialFlange;
  parameter SI.Force f_k(min = 0) = 0.1 "Amplitude of the force"
    annotation(__Daest(estimate = true, role = "size", null = 0));
  parameter SI.Length p(min = 1e-12) = 0.01 "Length of a period"
    annotation(__Daest(estimate = true, role = "shape", of = "s", periods = "s", grid = {0.1, 0.25, 0.5, 1}));
  parameter SI.Angle phi_0(min = -7, max = 7) = 0 "Phase of the force at s = 0"
    annotation(__Daest(estimate = true, role = "shape", grid = {0, 1.571, 3.142, 4.712}));
equation
  f = -f_k*sin(2*Daest.Constants.pi*s/p + phi_0);
  annotation(
    __Daest(effect = true, attach = "connector", law = "f = -f_k*sin(2*pi*s/p + phi_0)"),
    Documentation(info = "Magnets over slots, racks and belts. The force is conservative."));
end CoggingForce;
