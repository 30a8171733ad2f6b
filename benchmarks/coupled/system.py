"""Orders of the master for any FMUs on two coupled masses, and what a step of it costs.

Errors of each algorithm are those of the places against the closed solution of the coupled system.
The cost is that of a compiled step of both oscillators, and of the same step through fmpy's Python
classes; both are first checked for the same bits.
"""

import contextlib
import itertools
import math
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import numpy as np

from benchmarks.timing import best_s
from cosim.fmi.fmu import FmuError
from cosim.system.env import SystemEnv, SystemVectorEnv
from cosim.system.graph import Component, Connection
from cosim.system.ssp.reader import read_system
from cosim.system.system import MasterAlgorithm, System
from minirobots.options import CommandOptions, Count
from tests.references.masses_ssp import MASTERS, EndOfRun, write_archive
from tests.references.masses_ssp import run as run_other
from tests.references.two_masses import (
    BOND,
    BONDED,
    CONNECTIONS,
    PLACES,
    RESIDUAL,
    STATES,
    PythonLoop,
    bonded_masses,
    error,
    exact,
    exact_stiff,
    places,
    simulated,
    stiff_masses,
    stored,
    two_masses,
)

UNTIL_S = 1.0
STEPS_S = (4e-3, 2e-3, 1e-3, 5e-4)
TOLERANCES = (1e-3, 1e-4, 1e-5)
STIFF_STEPS_S = (1e-3, 1e-4, 1e-5)
SHORTEST_S = 1e-6
_STEP_S = 1e-4
_WITHIN = 100  # communication steps of a step of an environment
_ENVS = 8


class Options(CommandOptions):
    rounds: Count = 20
    """Rounds of the measurement of time; the best counts."""


def measure(options: Options) -> dict[str, Any]:
    found: dict[str, Any] = {"fixed": [], "adaptive": [], "stiff": [], "masters": []}
    with tempfile.TemporaryDirectory() as folder:
        components = two_masses(Path(folder))
        for algorithm in get_args(MasterAlgorithm):
            errors = []
            for step_s in STEPS_S:
                run, _ = simulated(components, UNTIL_S, step_s, algorithm)
                errors.append(error(run))
                order = math.log2(errors[-2] / errors[-1]) if errors[1:] else None
                row = {"algorithm": algorithm, "step_s": step_s, "error_m": errors[-1]}
                found["fixed"].append(row | {"order": order})
            for tolerance in TOLERANCES:
                run, system = simulated(components, UNTIL_S, SHORTEST_S, algorithm, tolerance)
                row = {"algorithm": algorithm, "tolerance": tolerance, "error_m": error(run)}
                calls = run.profile["first"].steps
                row |= {"steps": system.steps, "rejected": system.rejected, "calls": calls}
                found["adaptive"].append(row)
        found["rates"] = list(_rates(components))
        found["energy"] = list(_energy(Path(folder)))
        found["stiff"] = list(_stiff(Path(folder)))
        found["masters"] = list(_masters(Path(folder)))
        found |= _costs(components, options.rounds)
        found["ns_exchange"] = _exchange_ns(two_masses(Path(folder), interface="ModelExchange"))
    return found


def _rates(components: list[Component]) -> Iterator[dict[str, Any]]:
    """Errors where the second oscillator makes ten steps in one of the first."""
    for algorithm in ("jacobi", "gauss-seidel", "extrapolated"):
        for step_s in STEPS_S:
            row = {"algorithm": algorithm, "step_s": step_s}
            own = {"second": 0.1 * step_s}
            with System(components, CONNECTIONS, **row, component_steps=own) as system:
                yield row | {"error_m": error(system.run(UNTIL_S))}


def _energy(folder: Path) -> Iterator[dict[str, Any]]:
    """Energy that the coupling adds, and its difference from what is reported, by algorithm."""
    components = bonded_masses(folder)
    steps: list[tuple[float, dict[str, Any]]] = [(step_s, {}) for step_s in STEPS_S]
    for tolerance in (1e-2, 1e-3):
        options = {"tolerance": tolerance, "step_control": "energy", "longest_step_s": 0.01}
        steps.append((SHORTEST_S, options))
    for algorithm in get_args(MasterAlgorithm):
        for step_s, options in steps:
            given = {"step_s": step_s, "algorithm": algorithm, "record": STATES, **options}
            with System(components, BONDED, power_bonds=[BOND], **given) as system:
                run = system.run(UNTIL_S)
            added = stored(run) - stored(run)[0]
            yield {
                "algorithm": algorithm, "step_s": step_s, "tolerance": options.get("tolerance"),
                "steps": system.steps, "added_j": float(np.abs(added).max()),
                "difference_j": float(np.abs(run.signals[RESIDUAL] - added).max()),
                "error_m": error(run),
            }  # fmt: skip


def _stiff(folder: Path) -> Iterator[dict[str, Any]]:
    """Errors with the stiff coupling, by algorithm and step; infinite where values overflow."""
    components, links = stiff_masses(folder)
    for algorithm in get_args(MasterAlgorithm):
        for step_s in STIFF_STEPS_S:
            worst, row = math.inf, {"algorithm": algorithm, "step_s": step_s}
            with contextlib.suppress(FmuError), System(components, links, **row) as system:
                run = system.run(UNTIL_S)
                worst = float(np.abs(places(run) - exact_stiff(run.time_s)).max())
            yield row | {"error_m": worst}


def _masters(folder: Path) -> Iterator[dict[str, Any]]:
    """Errors after 1 s and times of a step, of other masters and of this one on one archive."""
    archive, steps = write_archive(folder), round(UNTIL_S / _STEP_S)
    truth = exact(np.array([UNTIL_S]), (1.0, 1.0))[:, 0]
    ends = {name: run_other(name, archive, _STEP_S, steps) for name in MASTERS}
    system = read_system(archive)
    for algorithm in get_args(MasterAlgorithm):
        with System(
            system.components, system.connections, algorithm=algorithm, step_s=_STEP_S
        ) as own:
            own.run(10 * _STEP_S)  # kernels are loaded
            begin = time.perf_counter_ns()
            last = own.run(UNTIL_S, every=steps).signals
            ns = (time.perf_counter_ns() - begin) / steps
            ends[f"minirobots, {algorithm}"] = EndOfRun([last[p][-1] for p in PLACES], ns)
    for name, end in ends.items():
        worst = float(np.abs(truth - end.places_m).max())
        yield {"master": name, "step_s": _STEP_S, "error_m": worst, "ns": end.ns}


def _costs(components: list[Component], rounds: int) -> dict[str, float]:
    """Times of a step of both oscillators in ns, and their ratio; the best round of each.

    `ratio_fmpy_to_env` is that of 100 steps by fmpy to a step of an environment over them,
    `env_instances_to_one` the throughput of eight environments in threads over that of one.
    """
    few, many = 500, 100_000
    by_python = PythonLoop(components)
    with System(components, CONNECTIONS, step_s=_STEP_S) as system:
        by_python.run(few, _STEP_S)
        run = system.run(few * _STEP_S)
        if [each[0] for each in by_python.outputs] != [run.signals[n][-1] for n in PLACES]:
            raise AssertionError("fmpy's loop and the compiled one give different bits")
        ends = (_STEP_S * (few + many * number) for number in itertools.count(1))
        works = (
            lambda: by_python.run(few, _STEP_S),
            lambda: system.run(next(ends), every=many),
        )
        fmpy_s, compiled_s = best_s(rounds, *works, clock=time.perf_counter)
    by_python.close()
    fmpy_s, compiled_s = fmpy_s / few, compiled_s / many
    env_s = _best_step_s(components, SystemEnv, (), _WITHIN, rounds)
    many_s, one_s = (
        _best_step_s(components, SystemVectorEnv, (n,), 10 * _WITHIN, rounds) for n in (_ENVS, 1)
    )
    return {
        "ratio_fmpy_to_env": _WITHIN * fmpy_s / env_s,
        "env_instances_to_one": _ENVS * one_s / many_s,
        "ns_fmpy": 1e9 * fmpy_s,
        "ns_compiled": 1e9 * compiled_s,
        "ratio_fmpy_to_compiled": fmpy_s / compiled_s,
    }


def _exchange_ns(components: list[Component]) -> float:
    """Time in ns of a step of both oscillators for Model Exchange, the mean of 1000."""
    with System(components, CONNECTIONS, step_s=_STEP_S) as system:
        system.run(100 * _STEP_S)
        return 1e6 * best_s(1, lambda: system.run(1100 * _STEP_S), clock=time.perf_counter)[0]


def _best_step_s(
    components: list[Component], kind: Any, count: tuple[int, ...], steps: int, rounds: int
) -> float:
    """Wall-clock time in s of a step of environments of the oscillators, the best of 10 `rounds`.

    `kind` is the class of the environment, `count` (n,) the instances of a vector, and `steps` the
    communication steps within. The first oscillator is pushed, and the second one follows it.
    """
    env = kind(
        *count,
        (components, [Connection("first.x", "second.x_in")]),
        actions={"first.F_in": (-50.0, 50.0)},
        observations=PLACES,
        reward=PLACES[1],
        step=steps * _STEP_S,
        step_s=_STEP_S,
    )
    env.reset(seed=0)
    push = np.ones((*count, 1))
    best = best_s(10 * rounds, lambda: env.step(push), clock=time.perf_counter)[0]
    env.close()
    return best
