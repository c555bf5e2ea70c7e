"""Simulations of the public Test Set for IVP Solvers, written as Modelica with bare equations in `models`,
beside scipy's Radau and CasADi's IDAS on the same problems written by hand (`dae_problems`).

One line per problem, tolerance and number of output points: the error of the worst variable at the end of
the time span in units of rtol, relative to the size of the variable (its root mean square along the
solution), and the time in seconds. The first run of daest compiles and is not counted; how long that takes
is told apart. The absolute tolerance of the peers is that of daest: a hundredth of rtol times the nominal
value.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import casadi as ca
import numpy as np
from dae_problems import Problem, problems
from scipy.integrate import solve_ivp

import daest
from daest.errors import DaestError
from daest.machine import described
from daest.systems.reduction.reduce import reduce_index
from daest.systems.simulation.simulate import simulate

MODELS = Path(__file__).parent / "models"
RTOLS = (1e-4, 1e-6, 1e-8, 1e-10)
POINTS = (11, 2001)
LONGEST = 60.0
"""A peer that needed longer [s] at one tolerance is not asked for a tighter one."""


@dataclass(frozen=True)
class Run:
    """Error at the end in units of rtol and seconds, of daest, scipy's Radau and IDAS; NaN where one did not
    arrive, `said` then tells what daest said."""

    problem: str
    rtol: float
    points: int
    error: float
    seconds: float
    said: str = ""
    radau_error: float = np.nan
    radau_seconds: float = np.nan
    idas_error: float = np.nan
    idas_seconds: float = np.nan


class Case:
    """One problem made ready: the explicit model, sizes of the variables, functions for the peers."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        start = time.perf_counter()
        self.model = reduce_index(daest.compile_model(MODELS / f"{problem.model}.mo"))
        grid = np.linspace(0.0, problem.t_end, POINTS[-1])
        along = simulate(self.model, (grid, np.zeros((grid.size, 0))))
        self.ready_seconds = time.perf_counter() - start
        self.size = {name: float(np.sqrt(np.mean(along[name] ** 2))) for name in problem.end}
        nominal = {v.name: v.nominal or 1.0 for v in self.model.flat.unknowns}
        self.atol = np.array([1e-2 * nominal.get(name, 1.0) for name in problem.x])

    def worst(self, found: dict[str, float], rtol: float) -> float:
        """Error in units of rtol among the variables found."""
        end = self.problem.end
        return max(abs(found[name] - end[name]) / self.size[name] for name in end if name in found) / rtol

    def daest(self, rtol: float, points: int) -> tuple[float, float]:
        grid = np.linspace(0.0, self.problem.t_end, points)
        start = time.perf_counter()
        result = simulate(self.model, (grid, np.zeros((points, 0))), rtol=rtol)
        seconds = time.perf_counter() - start
        return self.worst({name: float(result[name][-1]) for name in self.problem.end}, rtol), seconds

    def radau(self, rtol: float) -> tuple[float, float]:
        f = self.problem.explicit()
        x, t = f.mx_in()
        slopes = ca.Function("slopes", [x, t], [ca.densify(ca.jacobian(f(x, t), x))])
        start = time.perf_counter()
        run = solve_ivp(
            lambda t, x: f(x, t).full().ravel(), (0.0, self.problem.t_end), self.problem.x0, method="Radau",
            jac=lambda t, x: slopes(x, t).full(), rtol=rtol, atol=rtol * self.atol,
        )  # fmt: skip
        seconds = time.perf_counter() - start
        ends = dict(zip(self.problem.x, run.y[:, -1].tolist(), strict=True))
        return (self.worst(ends, rtol) if run.success else np.nan), seconds

    def idas(self, rtol: float) -> tuple[float, float]:
        """Along one interval, from start to end."""
        p = self.problem
        x, z = ca.vertcat(*p.x.values()), ca.vertcat(*p.z.values())
        dae = {"x": x, "z": z, "t": p.t, "ode": p.f, "alg": p.g}
        options = {
            "reltol": rtol, "abstol": rtol * float(self.atol.min()), "max_num_steps": 10_000_000,
            "init_xdot": ca.DM(self.problem.explicit()(p.x0, 0.0)).full().ravel().tolist(),
        }  # fmt: skip
        flow = ca.integrator("flow", "idas", dae, 0.0, p.t_end, options)
        start = time.perf_counter()
        try:
            found = flow(x0=p.x0, z0=p.z0)
        except RuntimeError:
            return np.nan, time.perf_counter() - start
        seconds = time.perf_counter() - start
        ends = dict(zip(p.x, found["xf"].full().ravel().tolist(), strict=True))
        ends |= dict(zip(p.z, found["zf"].full().ravel().tolist(), strict=True))
        return self.worst(ends, rtol), seconds


def measure(case: Case, rtol: float, points: int) -> Run:
    name = case.problem.model
    try:
        error, seconds = case.daest(rtol, points)
    except DaestError as problem:
        return Run(name, rtol, points, np.nan, np.nan, str(problem).splitlines()[0])
    return Run(name, rtol, points, error, seconds)


def with_peers(run: Run, case: Case, before: Run | None) -> Run:
    """The run with the peers' results beside it, without a peer that took `LONGEST` in the run `before`."""
    if before is None or not before.radau_seconds > LONGEST:
        error, seconds = case.radau(run.rtol)
        run = replace(run, radau_error=error, radau_seconds=seconds)
    if before is None or not before.idas_seconds > LONGEST:
        error, seconds = case.idas(run.rtol)
        run = replace(run, idas_error=error, idas_seconds=seconds)
    return run


def line(run: Run, tolerance: float) -> str:
    verdict = run.said or ("" if run.error <= tolerance else f"more than {tolerance:g}")
    numbers = [run.error, run.seconds, run.radau_error, run.radau_seconds, run.idas_error, run.idas_seconds]
    shown = "".join(f"{number:>11.3g}" for number in numbers)
    return f"{run.problem:<20}{run.rtol:>8.0e}{run.points:>6}{shown}  {verdict}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--problems", nargs="+", default=sorted(problems()), metavar="NAME")
    parser.add_argument("--rtol", nargs="+", type=float, default=RTOLS)
    parser.add_argument("--points", nargs="+", type=int, default=POINTS)
    parser.add_argument("--no-peers", action="store_true", help="daest alone")
    parser.add_argument("--json", type=Path, metavar="FILE")
    chosen = parser.parse_args()
    print(described(), flush=True)
    titles = ("error/rtol", "s", "Radau", "s", "IDAS", "s")
    print(f"{'problem':<20}{'rtol':>8}{'n':>6}" + "".join(f"{title:>11}" for title in titles))
    runs = []
    every = problems()
    for name in chosen.problems:
        try:
            case = Case(every[name])
        except DaestError as problem:
            print(f"{name:<20}{problem}")
            continue
        print(f"{name:<20}ready in {case.ready_seconds:.1f} s")
        for found in _measured(case, chosen.rtol, chosen.points, not chosen.no_peers):
            runs.append(found)
            print(line(found, case.problem.tolerance), flush=True)
    if chosen.json:
        chosen.json.write_text(json.dumps([asdict(run) for run in runs], indent=1))


def _measured(case: Case, rtols: list[float], points: list[int], peers: bool) -> Iterator[Run]:
    before = None
    for rtol in rtols:
        for count in points:
            run = measure(case, rtol, count)
            if peers and count == points[0]:
                run = before = with_peers(run, case, before)
            yield run


if __name__ == "__main__":
    main()
