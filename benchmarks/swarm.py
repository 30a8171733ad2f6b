"""Measure what a robot costs among many: time per robot, and memory.

2 to 1024 robots drive north on a lattice of 7 cm (2 cm between them), with noise, in one episode on
one core, without and with the shield. Rounds of all numbers of robots take turns; the best of each
counts. docs/performance.md explains what bounds the figures.
"""

import tracemalloc
from dataclasses import dataclass

from benchmarks.cosim_step import SHORT_S, driving
from benchmarks.timing import best_s
from cosim.base.command import Checked, Count
from cosim.model.params import TIMING

NUMBERS = (2, 16, 64, 256, 1024)


@dataclass(frozen=True, kw_only=True)
class Options(Checked):
    rounds: Count = 8
    """Rounds of every measurement; the best counts."""


def megabytes(robots: int) -> float:
    """Most memory that Python and numpy have taken for an episode after an RL step of 2 s."""
    tracemalloc.start()
    driving(robots, shield=True, rl_step_s=TIMING.rl_step_s)()
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return most / 1e6


def measure(options: Options) -> dict[str, float]:
    works = [driving(robots, shield=shield) for shield in (False, True) for robots in NUMBERS]
    per_robot = [s / n for s, n in zip(best_s(options.rounds, *works), 2 * NUMBERS, strict=True)]
    free, shielded = per_robot[: len(NUMBERS)], per_robot[len(NUMBERS) :]
    found = {f"robot_seconds_per_s_{n}": SHORT_S / s for n, s in zip(NUMBERS, free, strict=True)}
    found |= {f"shielded_{n}": SHORT_S / s for n, s in zip(NUMBERS, shielded, strict=True)}
    found["cost_per_robot_1024_to_16"] = free[-1] / free[1]
    found["shielded_cost_per_robot_1024_to_16"] = shielded[-1] / shielded[1]
    megabytes(NUMBERS[0])  # compiles, or loads from the cache
    return found | {f"megabytes_per_robot_{n}": megabytes(n) / n for n in NUMBERS[1:]}
