within Daest;
package Noise "Sources of white and coloured noise, one of each per domain"
  import Daest.Units.SI;
  annotation(
    Documentation(info = "White noise w is an input that is 0 unless a tool drives it. Its intensity is the two-sided
spectral density: E w(t) w(s) = intensity*delta(t - s). Coloured noise is a first-order (Ornstein-Uhlenbeck)
process with the autocovariance std^2*exp(-|t - s|/T). Noise may enter only where no unknown would contain its
derivative; the command daest noise tells. A source connects to the connectors of Daest and to those of the Modelica
Standard Library."));
end Noise;
