"""Code compiled ahead: while one process refits the leader of a screen, the others have nothing else to do
than to compile what the refits behind it run, which is then found where compiled libraries are kept."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

from daest.diagnosis.built_in.trials import Prepared
from daest.diagnosis.null_model.error_dynamics import is_varying, pushed_integrator
from daest.diagnosis.null_model.null import Null, searched_names
from daest.model.flat import ExplicitModel
from daest.systems.simulation.integrate import integrator

ONE_COMPILATION = 0.2  # [s], roughly


def compilations(null: Null, leader: Prepared, following: Sequence[Prepared]) -> list[Callable[[], None]]:
    """Tasks that compile what the judgement of the `leader` runs, and the searches for those `following`."""
    judgement = [leader.explicit] if leader.explicit is not None and is_varying(leader.explicit) else []
    searches = [
        partial(_compile_search, one.explicit, searched_names(null, one.names))
        for one in following
        if one.explicit is not None
    ]
    return [*(partial(_compile_judgement, explicit) for explicit in judgement), *searches]


def _compile_search(explicit: ExplicitModel, names: tuple[str, ...]) -> None:
    integrator(explicit, names)


def _compile_judgement(explicit: ExplicitModel) -> None:
    pushed_integrator(explicit)
