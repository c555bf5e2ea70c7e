model Signals "A first-order control loop with noise on its reference"
  Daest.Blocks.Interfaces.RealInput u(start = 0) "Reference";
  output Real y = x "Controlled variable";
  output Real total = constant_signal.y + sine.y "Sum of the source signals";
  Real x(start = 0) "Controlled variable";
  Daest.Blocks.Math.Feedback feedback "Control error";
  Daest.Blocks.Math.Gain gain(k = 4) "Controller";
  Daest.Blocks.Sources.Constant constant_signal(k = 3) "Constant";
  Daest.Blocks.Sources.Sine sine(amplitude = 2, f = 0.25, phase = 0.5, offset = 7) "Sine";
  Daest.Noise.White white(intensity = 1) "Noise";
  Daest.Noise.Coloured coloured(std = 2, T = 5) "Noise";
equation
  feedback.u1 = u + white.y + coloured.y;
  feedback.u2 = x;
  connect(feedback.y, gain.u);
  der(x) = gain.y;
end Signals;
