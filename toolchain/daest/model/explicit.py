"""ExplicitModel under its other address; it is defined beside the FlatModel that it belongs to."""

from daest.model.flat import ExplicitModel, InputDerivative

__all__ = ["ExplicitModel", "InputDerivative"]
