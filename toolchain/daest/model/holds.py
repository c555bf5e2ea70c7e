"""What inputs do between their samples.

A `Hold` is a word: `zoh`, all inputs keep their value until the next sample; `foh`, all run on straight lines
from sample to sample; `smooth`, all run on the cubic spline through their samples; `zoh(P, valve)`, those
named keep their value and all others run straight. A heating that a relay switches beside an outside
temperature is of the last kind, the road under a car that is sampled a few times in every wave is smooth.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import TypeAlias

import numpy as np

from daest.errors import ConfigError
from daest.near import nearest

Hold: TypeAlias = str

ZOH: Hold = "zoh"
FOH: Hold = "foh"
SMOOTH: Hold = "smooth"
HOLDS: tuple[Hold, Hold] = (FOH, ZOH)
"""Those of all inputs alike that any recording may have."""
ALIKE = (*HOLDS, SMOOTH)
"""Those of all inputs alike."""

LONGEST_KEPT = 1_000_000  # values of inputs whose slopes are kept

_MIXED = re.compile(r"zoh\(\s*(.+?)\s*\)")
_BETWEEN = re.compile(r",\s*(?![^\[]*\])")  # not those of u[1, 2]


def held_inputs(hold: Hold, names: Sequence[str]) -> np.ndarray:
    """Which of the inputs `names` keep their value between samples, (n_u,) of bool.

    >>> held_inputs("zoh(P)", ("P", "T_outside")).tolist()
    [True, False]
    """
    if hold in ALIKE:
        return np.full(len(names), hold == ZOH)
    named = _named(hold)
    return np.array([name in named for name in names], dtype=bool)


def mixed_hold(held: Iterable[str], names: Sequence[str]) -> Hold:
    """The hold with which the inputs `held` among `names` keep their value and the others run straight.

    >>> mixed_hold({"P"}, ("P", "T_outside")), mixed_hold({"P"}, ("P",)), mixed_hold((), ("P",))
    ('zoh(P)', 'zoh', 'foh')
    """
    kept = set(held)
    chosen = [name for name in names if name in kept]
    if not chosen:
        return FOH
    return ZOH if len(chosen) == len(names) else f"zoh({', '.join(chosen)})"


def interval_ends(inputs: np.ndarray, hold: Hold, names: Sequence[str]) -> np.ndarray:
    """The values (n_samples - 1, n_u) of inputs (n_samples, n_u) at the end of each sample interval. Columns
    behind those of `names` are driven by a measured signal."""
    unnamed = inputs.shape[1] - len(names)
    return np.where(held_inputs(hold, [*names, *[""] * unnamed]), inputs[:-1], inputs[1:])


def spline_slopes(inputs: np.ndarray, time: np.ndarray) -> np.ndarray:
    """The slopes (n_samples, n_u) of the cubic splines through inputs (n_samples, n_u) at their samples,
    whose third derivatives are continuous at the last samples but one (`not-a-knot`). Not to be written to:
    a search asks for the same ones in every run, and they are kept."""
    if inputs.shape[0] < 2 or not inputs.shape[1]:
        return np.zeros(inputs.shape)
    slopes = _slopes if inputs.size <= LONGEST_KEPT else _slopes.__wrapped__
    return slopes(inputs.tobytes(), time.tobytes(), inputs.shape[1])


@lru_cache(maxsize=8)
def _slopes(inputs: bytes, time: bytes, n_u: int) -> np.ndarray:
    from scipy.interpolate import CubicSpline

    t = np.frombuffer(time)
    found = CubicSpline(t, np.frombuffer(inputs).reshape(-1, n_u))(t, 1)
    found.flags.writeable = False
    return found


def resampled(inputs: np.ndarray, time: np.ndarray, at: np.ndarray, hold: Hold) -> np.ndarray:
    """Inputs (n_samples, n_u) between their samples at the times `at` (n_at,): on splines where they are
    smooth, else on straight lines."""
    from scipy.interpolate import CubicSpline

    if hold == SMOOTH and inputs.shape[0] > 1 and inputs.shape[1]:
        return CubicSpline(time, inputs)(at)
    columns = [np.interp(at, time, column) for column in inputs.T]
    return np.column_stack(columns) if columns else np.zeros((at.size, 0))


def causal_hold(hold: Hold) -> Hold:
    """The hold of a filter that runs along a stream, and of what is played: a spline needs later samples,
    straight lines only the next one.

    >>> causal_hold("smooth")
    'foh'
    """
    return FOH if hold == SMOOTH else hold


def hold_text(hold: Hold) -> str:
    """What the inputs do, as part of a sentence.

    >>> hold_text("zoh(P)")
    'P is held between the samples and the other inputs run straight'
    """
    if hold == ZOH:
        return "the inputs are held between the samples"
    if hold == FOH:
        return "the inputs run straight between the samples"
    if hold == SMOOTH:
        return "the inputs run on smooth curves through the samples"
    named = _named(hold)
    are = "is" if len(named) == 1 else "are"
    return f"{' and '.join(named)} {are} held between the samples and the other inputs run straight"


def is_hold(value: str) -> bool:
    """Whether a word has the form of a hold."""
    return value in ALIKE or _MIXED.fullmatch(value) is not None


def checked_hold(hold: Hold | None, names: Sequence[str], where: str = "hold") -> Hold | None:
    """The hold in its shortest form. Raises ConfigError `option-hold` where it names what is no input."""
    if hold is None or hold in ALIKE:
        return hold
    named = _named(hold)
    if not named:
        raise ConfigError(
            "option-hold",
            f"`{hold}` is no hold of inputs",
            where=where,
            remedy="Write zoh (held), foh (straight lines), smooth (curves), or zoh(NAME, ...) for those "
            "that are held.",
        )
    for name in named:
        if name not in names:
            raise ConfigError(
                "option-hold",
                f"{hold} names `{name}`, which is no input of the model",
                where=where,
                remedy=f"{nearest(name, names)} The inputs are: {', '.join(names) or 'none'}.".strip(),
            )
    return mixed_hold(named, names)


def _named(hold: Hold) -> tuple[str, ...]:
    found = _MIXED.fullmatch(hold)
    return tuple(_BETWEEN.split(found[1])) if found else ()
