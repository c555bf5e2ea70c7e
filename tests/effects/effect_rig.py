"""The rig of the tests: every effect at every place where it fits, and the law of an attached effect."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np

from daest.model.effects import Effect, Site
from daest.model.flat import FlatModel
from daest.model.parts import Equation
from daest.modelica.compile import compile_model
from daest.modelica.effects.attach import attach
from daest.modelica.effects.catalogue import effect_library, find_effect
from daest.modelica.effects.extend import extend_model
from daest.modelica.places.sites import find_site, fits, sites
from daest.systems.linear.linearize import linearize
from daest.systems.linear.split import split
from daest.systems.linear.transfer import poles

MODELS = Path(__file__).parent / "models"
RIG = MODELS / "Rig.mo"


@cache
def rig() -> FlatModel:
    return compile_model(RIG)


@cache
def rig_sites() -> tuple[Site, ...]:
    """Those of the rig, in which a liquid flows, and where a law of a gas is a law as well."""
    return tuple(replace(site, carries_gas=site.domain == "hydraulic") for site in sites(rig()))


def placements() -> list[tuple[Effect, Site]]:
    """Every effect with every site of the rig where it fits; of the parameters only J."""
    return [
        (effect, site)
        for effect in effect_library()
        for site in rig_sites()
        if fits(effect, site) and (site.kind != "parameter" or site.name == "J")
    ]


def first_places() -> list[tuple[Effect, Site]]:
    """Every effect with the first place of every kind."""
    seen: dict[tuple[str, str], tuple[Effect, Site]] = {}
    for effect, site in placements():
        seen.setdefault((effect.class_name, site.kind), (effect, site))
    return list(seen.values())


def examples(places: list[tuple[Effect, Site]]) -> list[tuple[Effect, Site]]:
    """One for each way to put an effect in and for each domain; the others say the same of slow tests."""
    shown: set[object] = set()
    chosen = []
    for effect, site in places:
        what = {effect.domain, (effect.attach, site.kind)}
        if not what <= shown:
            chosen.append((effect, site))
            shown |= what
    return chosen


def label(value: object) -> str:
    if isinstance(value, Effect):
        return value.class_name.removeprefix("Daest.Effects.")
    return value.name if isinstance(value, Site) else str(value)


def finite_poles(flat: FlatModel) -> np.ndarray:
    return np.sort_complex(poles(split(linearize(flat))))


def characteristic(flat: FlatModel) -> np.ndarray:
    """∏ (s - pole) at points off the poles over that at s = 1.3, as determinants of s E - J: well conditioned
    where poles coincide, as those of free bodies do."""
    dae = linearize(flat)
    points = np.array([0.7 + 0.3j, 2.0j, -0.4 + 5.0j, 1.3])
    sign, size = np.linalg.slogdet(points[:, None, None] * dae.E - dae.J)
    return sign[:-1] / sign[-1] * np.exp(size[:-1] - size[-1])


def law(flat: FlatModel, component: str, result: str, **given: float) -> float:
    """The value of `component.result` that its defining equation gives for `given` values of the component's
    other variables and parameters (`der_z` for a derivative); the parameters keep their values otherwise."""
    names, evaluate = _solved(flat, component, result)
    values = {p.name: p.value for p in flat.parameters}
    values |= {f"{component}.{name}": value for name, value in given.items()}
    values[f"{component}.{result}"] = 0.0
    return float(evaluate(*[values.get(name, given.get(name, 0.0)) for name in names]))


_functions: dict[tuple[int, str, str], tuple[FlatModel, list[str], ca.Function]] = {}


def _solved(flat: FlatModel, component: str, result: str) -> tuple[list[str], ca.Function]:
    """The names of the arguments, and the function that solves the defining equation; made once."""
    key = id(flat), component, result
    if key not in _functions:
        _functions[key] = flat, *_solving(flat, component, result)
    return _functions[key][1:]


def _solving(flat: FlatModel, component: str, result: str) -> tuple[list[str], ca.Function]:
    rows = [
        i
        for i, e in enumerate(flat.equations)
        if e.kind == "component" and defines(e, f"{component}.{result}")
    ]
    row = rows[-1]  # behind those of the partial models
    symbols = [*ca.vertsplit(flat.xi), *ca.vertsplit(flat.theta), *ca.vertsplit(flat.derivatives), flat.time]
    names = [x.name for x in flat.unknowns] + [p.name for p in flat.parameters]
    names += [f"{component}.der_{x.name.removeprefix(component + '.')}" for x in flat.unknowns] + ["time"]
    slope = ca.jacobian(
        flat.residual[row], flat.xi[[x.name for x in flat.unknowns].index(f"{component}.{result}")]
    )
    return names, ca.Function("law", symbols, [-flat.residual[row] / slope])


def defines(equation: Equation, name: str) -> bool:
    return equation.text.partition(" = ")[0] == name


def in_steps(folder, path, class_name, steps):
    """The model with effects put in one after the other, `steps` of (class name, place, values): by `attach`,
    and as the last of the texts that `extend_model` writes, each of which extends the one before."""
    expected = compile_model(path, class_name)
    for number, (name, place, values) in enumerate(steps):
        effect = find_effect(name)
        site = find_site(expected, place, effect)
        expected = attach(expected, effect, site, values=values)
        there = find_site(compile_model(path, class_name), site.name, effect)
        made = extend_model(path, class_name, effect, there, values=values)
        path, class_name = folder / f"step{number}.mo", made.class_name
        path.write_text(made.text)
    return expected, made
