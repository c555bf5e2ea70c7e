package Daest "Components of physical systems with the connectors and names of the Modelica Standard Library"
  annotation(
    version = "0.1.0",
    Documentation(info = "A model made of these components becomes a model of the Modelica Standard Library 4 when the
prefix Daest. is replaced by Modelica. everywhere but in Daest.Noise, Daest.Terms and Daest.Hydraulic, which have no
counterpart there; Daest.Noise connects to the connectors of the Standard Library as it is.

Signs: a flow variable (current, torque, force, heat flow, volume flow) is positive when it flows into the
component."));
end Daest;
