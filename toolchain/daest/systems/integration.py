"""What the compiled integration (`radau.c`) hands over and answers."""

from __future__ import annotations

from daest.errors import NumericalError

FAILURES = {
    1: "the step size became too small: a singularity, or a discontinuity that is not smoothed",
    2: "{steps} steps lead no farther, the next would be {next:.2g} s long: the model moves much "
    "faster than the record, or is not smooth there",
    3: "the model gives no finite derivative",
    4: "there is not enough memory",
    5: "the constraints of the model depend on each other there",
    6: "after {steps} steps the steps are so short ({next:.2g} s) that the end is out of reach: a "
    "discontinuity that is not smoothed, or a motion much faster than the record",
}


class IntegrationError(NumericalError):
    """The integration stopped at `time`; a search steps back from such a point instead of giving up."""

    def __init__(self, reason: str, time: float) -> None:
        super().__init__(
            "integration-failed",
            f"The simulation stopped at t = {time:.6g} s: {reason}.",
            remedy="Look at the parameter values and the state then; smooth discontinuities with a width.",
        )
        self.reason, self.time = reason, time

    def __reduce__(self) -> tuple:
        return type(self), (self.reason, self.time)
