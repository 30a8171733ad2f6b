"""`python -m benchmarks NAME`: what things cost, how they converge, and what helps.

A benchmark is a module with `show` and with `measure`, whose arguments are the options in the
`options.py` of its folder.
"""

from dataclasses import asdict
from importlib import import_module
from typing import Any, Union

import tyro

from benchmarks.coupled.options import ReferenceFmus, System
from benchmarks.learning.options import Envs, MovesLearning, Training
from benchmarks.masters.options import Ssp
from benchmarks.options import (
    Benchmark,
    Convergence,
    CosimStep,
    DriveMap,
    Evaluation,
    FmuStep,
    Identification,
    Positioning,
    Reaction,
    Recording,
    Sensitivity,
    Steering,
)
from benchmarks.reliability.options import (
    Adversaries,
    Coverage,
    Endurance,
    Falsification,
    Mutations,
    Splitting,
)
from cosim.base.command import print_json
from cosim.base.errors import run_command
from cosim.base.progress import progress_bars, under_way

MODULES: dict[type[Benchmark], str] = {
    Adversaries: "reliability.adversaries",
    Convergence: "convergence",
    CosimStep: "cosim_step",
    Coverage: "reliability.coverage",
    DriveMap: "drive_map",
    Endurance: "reliability.endurance",
    Envs: "learning.envs",
    Evaluation: "evaluation",
    Falsification: "reliability.falsification",
    FmuStep: "fmu_step",
    Identification: "identification",
    Mutations: "reliability.mutations",
    MovesLearning: "learning.moves_learning",
    Positioning: "positioning",
    Reaction: "reaction",
    Recording: "recording",
    ReferenceFmus: "coupled.reference_fmus",
    Sensitivity: "sensitivity",
    Splitting: "reliability.splitting",
    Ssp: "masters.ssp",
    Steering: "steering",
    System: "coupled.system",
    Training: "learning.training",
}


def main() -> None:
    """Command line; see the classes above."""
    choice: Any = Union[tuple(MODULES)]  # noqa: UP007 - of types that are listed above
    config = (tyro.conf.FlagCreatePairsOff,)
    options: Benchmark = tyro.cli(choice, prog="python -m benchmarks", config=config)
    arguments = asdict(options)
    as_json = arguments.pop("json")
    name = MODULES[type(options)]
    module = import_module(f"benchmarks.{name}")
    with progress_bars() as progress, under_way(progress, f"benchmark {name.rpartition('.')[2]}"):
        found = module.measure(**arguments)
    module.show(found)
    if as_json:
        print_json(found)


if __name__ == "__main__":
    run_command(main)
