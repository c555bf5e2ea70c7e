"""daest: from a Modelica model and a recording to parameters, states and the physics that the model lacks."""

__version__ = "0.1.0"
