"""Aims of `daest design` from the command line and from results/diagnosis.json."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from daest.cli.output import note
from daest.cli.results import read_document
from daest.errors import EstimationError, ModelError

if TYPE_CHECKING:
    import numpy as np

    from daest.data.project import Project
    from daest.design.aims import ParameterAim
    from daest.design.detect import DetectAim
    from daest.design.effects import Loop, Rival
    from daest.design.prepared import Subject
    from daest.design.rivals import RivalAim
    from daest.model.design import Criterion, Limits
    from daest.model.effects import Effect, Site
    from daest.model.flat import Model

DIAGNOSIS = "diagnosis.json"
OPEN = "not separable"  # verdict of a candidate that has rivals
SCREENED = 100  # candidates that a search is taken to have, where no diagnosis tells


def parameter_aim(
    flat: Model,
    limits: Limits,
    recorded: Sequence[np.ndarray],
    names: Sequence[str],
    criterion: Criterion,
) -> tuple[ParameterAim, tuple[Subject, ...]]:
    """The aim of knowing the parameters `names` (default: all that are estimated) better, besides the others
    that are estimated. Raises EstimationError `identify-nothing-to-estimate`, `unknown-parameter`. Shapes:
    recorded inputs (n_samples, n_u) each."""
    import numpy as np

    from daest.design.aims import ParameterAim
    from daest.design.explainer import total_information
    from daest.design.prepared import Subject, estimated_names, explainer

    estimated = estimated_names(flat)
    every = tuple(dict.fromkeys([*estimated, *names]))
    if not every:
        raise EstimationError(
            "identify-nothing-to-estimate",
            "no parameter is marked as unknown",
            remedy="name them with --parameters, or mark them in daest.toml: "
            "[parameters] NAME = { estimate = true }",
        )
    subject = Subject(flat, every, unknown_noise=True)
    driven = explainer(subject, limits.period, limits.hold)
    p = len(driven.coordinates)
    found = total_information(driven, recorded)
    known = np.zeros((p, p)) if found is None else found
    interest = tuple(i for i, name in enumerate(every) if name in (names or every))
    return ParameterAim(driven, interest, criterion, known), (subject,)


def survivors(project: Project) -> list[Mapping[str, Any]]:
    """Candidates of the kept diagnosis that could not be told apart; none without one."""
    path = project.results / DIAGNOSIS
    if not path.is_file():
        return []
    return [c for c in read_document(path).get("candidates", ()) if c.get("verdict") == OPEN]


def rivals_of(
    project: Project,
    flat: Model,
    limits: Limits,
    recorded: Sequence[np.ndarray],
    folders: Sequence[Path],
    seed: int,
    loop: Loop,
) -> tuple[RivalAim, tuple[Subject, ...]]:
    """The aim of telling apart what results/diagnosis.json leaves, each in the loop of the controller. Raises
    EstimationError `design-no-rivals`. Shapes: recorded inputs (n_samples, n_u) each."""
    from daest.design.effects import rival_aim
    from daest.diagnosis.gates import GATES

    found = [_rival(flat, entry, folders, loop) for entry in survivors(project)]
    return rival_aim([r for r in found if r is not None], limits, recorded, 0.5 * GATES.same_bic, seed)


def _rival(flat: Model, entry: Mapping[str, Any], folders: Sequence[Path], loop: Loop) -> Rival | None:
    """The candidate as a model, with the values and the noise of its fit; None where it cannot be built."""
    from daest.cli.results import parameter_values
    from daest.design.effects import Rival, leaving, with_effect
    from daest.design.sensors import COMPONENT
    from daest.model.flat import with_equations

    label = f"{entry['effect']} at {entry['at']}"
    if entry.get("inputs"):
        note(f"{label} needs a recorded signal that no design can foresee: left out")
        return None
    try:
        effect, site = _placed(flat, entry.get("class") or entry["effect"], entry["at"], folders)
        values = parameter_values({"parameters": entry["parameters"]}) | dict(entry.get("settings", {}))
        grown = with_effect(with_equations(flat, "an effect"), effect, site, values, {})
    except ModelError as problem:
        note(f"{label} cannot be built: {problem.what}")
        return None
    grown = grown.with_theta(parameter_values({"parameters": entry.get("model_parameters", {})}))
    names = [*entry.get("model_parameters", {}), *(f"{COMPONENT}.{name}" for name in entry["parameters"])]
    return Rival(label, leaving(loop(grown), entry["rms"]["estimation"]), tuple(names))


def effect_aim(
    project: Project,
    flat: Model,
    limits: Limits,
    recorded: Sequence[np.ndarray],
    name: str,
    place: str | None,
    size: float | None,
    folders: Sequence[Path],
    loop: Loop,
) -> tuple[DetectAim, tuple[Subject, ...]]:
    """The aim of seeing an effect. Raises ModelError `effect-unknown`, `effect-place`, `effect-fit`. Shapes:
    recorded inputs (n_samples, n_u) each."""
    from daest.design.effects import detect_aim
    from daest.diagnosis.foreseeable import beside_loads, required
    from daest.model.flat import with_equations

    effect, site = _placed(flat, name, place, folders)
    path = project.results / DIAGNOSIS
    screen = read_document(path).get("screen", {}) if path.is_file() else {}
    loaded, loads = beside_loads(with_equations(flat, "an effect"))
    asked = required(screen.get("n_screened") or SCREENED)
    return detect_aim(
        loaded, effect, site, limits, recorded, size=size, required=asked, loads=loads, loop=loop
    )


def _placed(flat: Model, name: str, place: str | None, folders: Sequence[Path]) -> tuple[Effect, Site]:
    """The effect of that name that fits at the place, or at the first place where one fits."""
    from daest.modelica.effects.catalogue import find_effects
    from daest.modelica.places.sites import find_effect_site, fits, sites

    group = find_effects(name, folders)
    if place is None:
        for effect in group:
            for site in sites(flat):
                if fits(effect, site):
                    note(f"{effect.name} at {site.name}; --at names another place")
                    return effect, site
    return find_effect_site(flat, group, place or group[0].domain)
