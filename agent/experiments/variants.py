"""The experiments: which variants each of them compares, and with which one."""

import itertools
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import tyro

from agent.mdp.config import ProcessConfig
from agent.training.settings import LearningConfig, MethodName
from cosim.base.command import Checked, Count, NewFolder, Seed
from cosim.base.jobs import PROCESSES, Where
from cosim.base.reading import Kind, read_toml

Name = Literal["fig08", "fig10", "fig11", "features", "readings", "zone", "factorial", "sequel"]
_DECLARED = Path(__file__).with_name("experiments.toml")
_COEFFICIENTS = (1.0, 1.5, 2.0, 5.0)  # c of Fig. 10


@dataclass(frozen=True, kw_only=True)
class ExperimentOptions(Checked):
    """How an experiment is run."""

    experiment: Annotated[Name, tyro.conf.Positional]
    """Experiment to run."""
    out: NewFolder = None
    runs: Count = 20
    """Independent runs of each variant (the paper: 20)."""
    seed: Seed = 0
    episodes: Count = LearningConfig().episodes
    """Training episodes of a run (Section V: 5 000 000)."""
    greedy_points: Count = LearningConfig().greedy_points
    """Exact evaluations of the greedy policy during a run, evenly spread."""
    where: Where = PROCESSES


class Variant(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One line of a figure or table."""

    label: str
    scenario: str  # name of a built-in scenario
    reference: str | None = None  # name of the variant that it is compared with, if any
    process: ProcessConfig = ProcessConfig()
    # Learning configuration; the command may change its number of episodes
    learning: LearningConfig = LearningConfig()
    method: MethodName = "paper"


def variants_of(experiment: Name) -> dict[str, Variant]:
    """Return the variants of an experiment by name."""
    if experiment == "factorial":
        return _factorial()
    declared = read_toml(_DECLARED, Kind("experiments", "install it again"))
    return msgspec.convert(declared[experiment], dict[str, Variant])


def _factorial() -> dict[str, Variant]:
    """Return every combination of the interpretations that may decide Fig. 10, with each c.

    A label has a word for the level of every factor, and c as its last.
    """
    found = {}
    for scenario, zone, target, eta, schedule, c in itertools.product(
        ("2", "3", "4"),
        ("", "-zone"),
        ("cell", "disk"),
        (0.01, 0.001),
        ("geometric", "linear"),
        _COEFFICIENTS,
    ):
        name, levels = f"{scenario}{zone}", (target, f"eta{eta:g}", schedule)
        found["-".join((name, *levels, f"c{c:g}"))] = Variant(
            " ".join((f"scenario{scenario}", zone[1:] or "open", *levels, f"c{c:g}")),
            name,
            None if c == 1.5 else "-".join((name, *levels, "c1.5")),
            ProcessConfig(approach_coefficient=c, target_obstacle=target),
            LearningConfig(eta=eta, schedule=schedule),
        )
    return found
