"""Values of a diagnosis: the null model, candidates, what the screen and the proof found, the verdict."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from daest.model.effects import Effect, Site
from daest.model.fit import Agreement, FitResult
from daest.model.flat import Model
from daest.model.holds import Hold
from daest.model.shown import Framed, Listing

VerdictName = Literal[
    "nothing missing",
    "parameters off",
    "supported",
    "cannot tell",
    "unknown effect",
    "external disturbance",
]
CandidateVerdict = Literal["supported", "not separable", "rejected"]


@dataclass(frozen=True)
class Load:
    """A coloured external load at a place of the model: d' = -d/T + w, entering the flow balance of a node.

    `places` are the nodes that the sensors cannot tell apart from this one; `size` is the standard deviation
    of d that the data ask for, in `unit`.
    """

    name: str
    place: str
    places: tuple[str, ...]
    time_constant: float
    size: float
    unit: str


@dataclass(frozen=True)
class Candidate:
    """An effect at a site as component `name`, with its shape and sharpness values, those of them that a
    proof takes in place of the screen's (`proved`), the recorded signals that supply its inputs with their
    units where they are known, and the units that its parameters have there. `searched` counts the values of
    its shape that were compared on the data before it was chosen. `keeps_order`: at this place the effect
    brings no state of its own, whatever it does elsewhere (an inductance beside one that the model has)."""

    effect: Effect
    site: Site
    name: str
    shape: dict[str, float] = field(default_factory=dict)
    inputs: dict[str, str] = field(default_factory=dict)
    input_units: dict[str, str] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    searched: int = 1
    keeps_order: bool = False
    proved: dict[str, float] = field(default_factory=dict)

    @property
    def is_dynamic(self) -> bool:
        """Whether the model changes its order or index where the sizes vanish."""
        return self.effect.is_dynamic and not self.keeps_order

    @property
    def n_memory(self) -> int:
        """The number of states that the effect adds. Their starts are free, and those of a dead time, which
        has ten, follow any transient: each counts as a parameter."""
        return self.effect.n_states if self.is_dynamic else 0

    @property
    def n_unknowns(self) -> int:
        """How much a fit with the effect is free in beside one without it."""
        return len(self.estimated) + self.n_memory

    @property
    def is_of_signal(self) -> bool:
        """Whether it stands at a signal: an input, an output or one between them."""
        return self.site.kind in ("input", "output", "signal")

    @property
    def is_of_parameter(self) -> bool:
        """Whether it stands at a parameter of the model, which changes with it."""
        return self.site.kind == "parameter"

    @property
    def is_of_recorded(self) -> bool:
        """Whether it stands at a signal that is recorded: an input or an output."""
        return self.site.kind in ("input", "output")

    @property
    def estimated(self) -> tuple[str, ...]:
        """Names in the model of the effect's parameters that are estimated."""
        return tuple(f"{self.name}.{p.name}" for p in self.effect.parameters if p.estimate)

    @property
    def size_unit(self) -> str:
        """Unit of the first size parameter of the effect; empty if it is unknown."""
        size = self.effect.sizes[0]
        return self.units.get(size.name, size.unit)

    @property
    def label(self) -> str:
        signal = f" ({', '.join(self.inputs.values())})" if self.inputs else ""
        return f"{self.effect.name}{signal} at {self.site.name}"


@dataclass(frozen=True)
class Screened:
    """Score of one candidate. `score` is as large as a standard normal variable when nothing is missing;
    `sizes` are the one-step estimates of the effect's sizes; `absorbed` tells that the refitted parameters do
    all that the effect could do; `detectable` is the smallest size that would have been seen (at the level of
    the search, power 0.9); `share` is the part of the squared residual that it would explain (FMUs only);
    `size_error` is the standard error of the first size alone, 0 where the parameters absorb it."""

    candidate: Candidate
    score: float
    sizes: tuple[float, ...]
    p_value: float  # corrected for the search over all candidates
    absorbed: bool
    detectable: float
    share: float | None = None
    size_error: float = 0.0

    @property
    def deviation(self) -> float:
        """The first size off its null in standard errors: negative where an effect that can only brake would
        have to drive, though its score is 0 then."""
        off = self.sizes[0] - (self.candidate.effect.sizes[0].null or 0.0)
        return off / self.size_error if self.size_error > 0.0 else 0.0


@dataclass(frozen=True)
class Screen:
    """All candidates, highest score first, with the correlations (n, n) of their scores in that order."""

    entries: tuple[Screened, ...]
    correlation: np.ndarray
    p_value: float
    n_screened: int
    skipped: tuple[tuple[str, str], ...]  # candidates that could not be tried, with the reason

    def only(self, rows: Sequence[int]) -> Screen:
        """With these entries alone, in this order."""
        kept = list(rows)
        return replace(
            self,
            entries=tuple(self.entries[i] for i in kept),
            correlation=self.correlation[np.ix_(kept, kept)],
        )


@dataclass(frozen=True)
class FreeForm:
    """The load at `place` (number `load` of the null) as a curve w(x) ± std over `variable`, times the sign
    of the speed `sign_of` if that is given; of an angle that turns round, over one turn.

    `statistic` is chi-squared with `degrees` when the load does not follow the variable; `p_value` is
    corrected for the search over all forms.
    """

    load: int
    place: str
    variable: str
    sign_of: str
    unit: str
    variable_unit: str
    statistic: float
    degrees: int
    p_value: float
    x: np.ndarray
    w: np.ndarray
    std: np.ndarray
    over_a_turn: bool = False

    @property
    def label(self) -> str:
        return f"{self.variable} and the sign of {self.sign_of}" if self.sign_of else self.variable

    @property
    def log_likelihood_gain(self) -> float:
        """Gain in log-likelihood, minus the expected gain of as many useless parameters."""
        return max(0.5 * (self.statistic - self.degrees), 0.0)


@dataclass(frozen=True)
class Curve:
    """A load as straight lines through (x, y) over `variable`, constant beyond the outermost knots or, if
    `period` is not 0, periodic; times tanh(speed / sign_width) of the speed `sign_of` if that is given. `std`
    is NaN where the data do not determine a value."""

    variable: str
    sign_of: str
    sign_width: float
    period: float
    x: np.ndarray
    y: np.ndarray
    std: np.ndarray


@dataclass(frozen=True)
class Coefficient:
    """Of a `term` of a formula ("1" for a constant). The unit is empty where no whole exponents write it."""

    term: str
    value: float
    std_error: float
    unit: str


@dataclass(frozen=True)
class Formula:
    """A short formula for a curve: its text, its coefficients, how many numbers it has, and the share of the
    curve's size (in its standard errors) that it leaves."""

    text: str
    coefficients: tuple[Coefficient, ...]
    n_numbers: int
    left: float


@dataclass(frozen=True)
class LearnedLoad:
    """The load of `form` as a part of the model: its curve, all parameter values, and the errors (rms) of the
    simulation on validation data without and with it. `fit` is None where no refit succeeded and the curve
    is that of the form. A positive load flows into the components at the place if `sign` is 1. `keeps_hold`:
    with the curve in the model, the other hold of the inputs is no better."""

    form: FreeForm
    curve: Curve
    theta: Mapping[str, float]
    fit: FitResult | None
    before: Mapping[str, float | None]
    after: Mapping[str, float | None]
    sign: float = 1.0
    against: str = ""  # why unseen data speak against it
    formula: Formula | None = None  # for the curve, where there is a short one
    keeps_hold: bool = False


@dataclass(frozen=True)
class Ahead:
    """Unseen data foreseen `samples` (`seconds`) ahead: the error with an effect in the model relative to the
    one without (rms over all outputs), and how many standard errors the difference of their squares is from
    none. `kept` is the error of values that stay what they are, relative to that without the effect."""

    samples: int
    seconds: float
    ratio: float
    certainty: float
    kept: float = math.inf


@dataclass(frozen=True)
class Confirmed:
    """What the likelihood of unseen data says of a law: its gain, how many standard errors that is over the
    stretches of the data, and the gain that is to be expected if the law is right."""

    gain: float = 0.0
    certainty: float = 0.0
    expected: float = np.inf


@dataclass(frozen=True)
class InUse:
    """What a simulation says of a law: the logarithms of the ratios of mean squared errors without to with
    it, of the `fitted` and of the `unseen` data, the samples of each that count as independent (0: nothing is
    known), and how many standard errors the mean squares of the unseen ones are apart. `piece` is the
    duration [s] over which it is told, of the records or pieces of them, each from a start of its own; 0
    where it is evidence beside others. The mean squares are over all outputs; `apart` are the same two
    logarithms of every output by itself, in their mean: what the likelihood of their own errors gains.
    `leaves_noise`: errors of unseen data that lasted without the law do not with it."""

    fitted: float = 0.0
    unseen: float = 0.0
    n_independent: float = 0.0
    n_unseen: float = 0.0
    certainty: float = 0.0
    piece: float = 0.0
    apart: tuple[float, float] | None = None
    leaves_noise: bool = False

    @property
    def gain(self) -> float:
        """In log-likelihood."""
        return 0.5 * (self.n_independent * self.fitted + self.n_unseen * self.unseen)

    @property
    def ratio(self) -> float:
        """Of the errors on unseen data, with to without the law."""
        return float(np.exp(-0.5 * self.unseen))

    @property
    def by_output(self) -> InUse:
        """The same with every output for itself, as laws are compared: one that leaves an output as it is,
        and does away with the error of the other, is no worse than one that takes a part of both."""
        return self if self.apart is None else replace(self, fitted=self.apart[0], unseen=self.apart[1])

    def bic(self, n_own: int) -> float:
        """Gain for a law of `n_own` parameters."""
        return 2.0 * self.gain - n_own * float(np.log(max(self.n_independent, 1.0)))


@dataclass(frozen=True)
class Proof:
    """A candidate built into the model and refitted. `fit` is beside the unknown loads, which is what the
    tests rest on, and tells no agreement with data where there is a `final`, that without coloured ones,
    which is what is told. `explained` is the share of the load's size that vanished; `left` the form that the
    rest of the load follows best; `ahead` what it does to the prediction of unseen data; `adds_up` tells that
    a whole simulation of the model is dead reckoning, but of the outputs `holding`; `steady_error` is that of
    simulated unseen data, each with a constant load of its own, whitened."""

    candidate: Candidate
    flat: Model
    fit: FitResult
    delta_log_likelihood: float
    delta_bic: float
    p_value: float  # likelihood ratio, corrected for the search over all candidates
    explained: float
    equivalent: tuple[str, ...]  # places where the sensors would not see a difference
    not_separable_from: tuple[str, ...]
    verdict: CandidateVerdict
    reason: str
    left: FreeForm | None = None
    final: FitResult | None = None  # None: not searched for, since the tests of `fit` have failed
    ahead: tuple[Ahead, ...] = ()
    is_open: bool = False  # rejected, though nothing speaks against it: the data may still mean it
    is_vague: bool = False  # rejected for nothing but that the data determine none of its parameters
    takes_little: bool = False  # rejected for nothing but that too much of the load is left
    is_any_dynamics: bool = False  # rejected, since any lag or delay as short as that would do
    comes_near: bool = False  # rejected, since what a lag or delay leaves is dynamic, too
    is_other_law: bool = False  # rejected, since what it leaves follows a variable that tells all of it
    is_known: bool = True  # False: the data show too little of the law to tell it from any other
    confirmed: Confirmed = Confirmed()
    adds_up: bool = False
    holding: tuple[str, ...] = ()
    in_use: InUse = InUse()  # by its simulation
    is_shown: bool = False  # by its simulation, by more than chance
    is_by_use: bool = False  # the deltas are those in use
    same_as: tuple[str, ...] = ()  # other laws that are the same equation on these recordings
    inside: str = ""  # of a sensor: what in the machine is the same equation on these recordings
    steady_error: float | None = None
    stands_for: tuple[str, ...] = ()  # rejected, since these laws beside each other, its parts, say more
    given_values: tuple[str, ...] = ()  # parameters of which another value than the given one says as much

    @property
    def sizes(self) -> tuple[float, ...]:
        """Those of the effect beside the unknown loads."""
        name = self.candidate.name
        return tuple(self.fit.theta[f"{name}.{p.name}"] for p in self.candidate.effect.sizes)

    @property
    def places(self) -> frozenset[str]:
        """The names of its place and of those where the sensors would see no difference."""
        return frozenset((self.candidate.site.name, *self.equivalent))

    @property
    def told(self) -> FitResult:
        """The fit whose sizes and errors are told."""
        return self.final or self.fit


@dataclass(frozen=True)
class Unproved:
    """A candidate that led the screen, or came to be tried, without a refit: the `reason` says why.
    `has_failed` tells that its refit was tried in vain, so that it may well be what is missing, `is_late`
    that it was not begun since the time was up, and `is_present` that the model holds it at given values."""

    candidate: Candidate
    equivalent: tuple[str, ...]
    score: float
    p_value: float
    sizes: tuple[float, ...]
    reason: str
    has_failed: bool = False
    is_late: bool = False
    is_present: bool = False


@dataclass(frozen=True)
class PlaceGain:
    """How much log-likelihood a load at a place buys, and the places that these sensors cannot separate from
    it."""

    group: tuple[str, ...]
    log_likelihood_gain: float
    size: float
    unit: str


@dataclass(frozen=True)
class Diagnosis(Framed):
    """The result of `diagnose`. `has_loads`: the model as it is was fitted together with unknown loads;
    `is_held`: its parameters were not estimated beside them; `is_whole`: the time sufficed for all refits;
    `is_by_colour`: that prediction errors are correlated in time is all that the verdict rests on, and
    `is_of_starts`: that loads begin with the recordings."""

    verdict: VerdictName
    message: str
    baseline: FitResult
    proofs: tuple[Proof, ...]
    screen: Screen
    places: tuple[PlaceGain, ...]
    disturbance: FreeForm | None
    validation: Agreement | None
    next_experiment: str
    seconds: float
    learned: LearnedLoad | None = None  # of an unknown effect
    unproved: tuple[Unproved, ...] = ()
    has_loads: bool = True
    is_held: bool = False
    is_whole: bool = True
    is_by_colour: bool = False
    is_of_starts: bool = False

    def tables(self) -> tuple[Listing, ...]:
        columns = ("effect", "at", "verdict", "delta_bic", "p_value")
        rows = tuple(
            (p.candidate.effect.name, p.candidate.site.name, p.verdict, p.delta_bic, p.p_value)
            for p in self.proofs
        )
        return (Listing(f"{self.verdict}: {self.message}", columns, rows),)


@dataclass(frozen=True)
class Step:
    """One round of `improve`: the effect that was added (None: the model as it was), the fit after it, and
    the diagnosis that proposed it. `is_unproven` tells that it shows only together with what follows."""

    proof: Proof | None
    fit: FitResult
    diagnosis: Diagnosis | None
    remark: str
    is_unproven: bool = False


@dataclass(frozen=True)
class Improvement(Framed):
    """The rounds, the diagnosis that ended them, and why they ended; `recorded_hold` is that of the inputs
    between the samples of the recordings."""

    steps: tuple[Step, ...]
    last: Diagnosis
    reason: str
    recorded_hold: Hold | None = None

    def tables(self) -> tuple[Listing, ...]:
        rows = tuple(
            (i, "" if step.proof is None else step.proof.candidate.name, step.remark, step.fit.log_likelihood)
            for i, step in enumerate(self.steps)
        )
        return (Listing(self.reason, ("step", "added", "remark", "log-likelihood"), rows),)
