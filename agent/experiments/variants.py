"""The experiments: which variants each of them compares, and with which one."""

import itertools
from collections.abc import Mapping
from typing import Literal, NamedTuple

from agent.mdp.config import Feature, ProcessConfig
from agent.training.settings import Algorithm, LearningConfig
from cosim.model.scenario_file import IN_GROUPS, PAPER, RESTRICTED

Name = Literal["fig08", "fig10", "fig11", "features", "readings", "zone", "factorial", "sequel"]


class Variant(NamedTuple):
    """One line of a figure or table.

    Attributes:
        label: for people.
        scenario: name of a built-in scenario.
        process: readings of the decision process.
        learning: learning configuration; the command may change its number of episodes.
    """

    label: str
    scenario: str
    process: ProcessConfig = ProcessConfig()
    learning: LearningConfig = LearningConfig()


def _scenarios(*names: str) -> dict[str, Variant]:
    return {name: Variant(f"scenario {name}", name) for name in names}


# The paper does not say on which scenario Fig. 10 was made; 4 has the most encounters (assumed).
_PAIRS, _HARDEST = ("2", "3", "4"), "4"
_FEATURES: tuple[tuple[Feature, ...], ...] = (
    ("x", "y"),
    ("x", "y", "d"),
    ("x", "y", "g"),
    ("x", "y", "d", "g"),
    ("x", "y", "d", "g", "b"),
)
_ALGORITHMS: dict[Algorithm, str] = {"q": "Q-learning", "double_q": "double Q-learning"}

_COEFFICIENTS = (1.0, 1.5, 2.0, 5.0)  # c of Fig. 10, and 1, which penalises nothing more


def _factorial() -> dict[str, Variant]:
    """Return every combination of the interpretations that may decide Fig. 10, with each c.

    A label has a word for the level of every factor, and c as its last.
    """
    found = {}
    for scenario, zone, target, eta, schedule, c in itertools.product(
        _PAIRS,
        ("", "-zone"),
        ("cell", "disk"),
        (0.01, 0.001),
        ("geometric", "linear"),
        _COEFFICIENTS,
    ):
        name, *levels = f"{scenario}{zone}", target, f"eta{eta:g}", schedule, f"c{c:g}"
        found["-".join((name, *levels))] = Variant(
            " ".join((f"scenario{scenario}", zone[1:] or "open", *levels)),
            name,
            ProcessConfig(approach_coefficient=c, target_obstacle=target),
            LearningConfig(eta=eta, schedule=schedule),
        )
    return found


EXPERIMENTS: dict[Name, dict[str, Variant]] = {
    "fig08": _scenarios("1a", "1b"),
    "fig10": {
        f"c{c:g}": Variant(f"c = {c:g}", _HARDEST, ProcessConfig(approach_coefficient=c))
        for c in _COEFFICIENTS
    },
    "fig11": _scenarios(*_PAIRS),
    "features": {
        "".join(features): Variant(
            f"features {', '.join(features)}", _HARDEST, ProcessConfig(features=features)
        )
        for features in _FEATURES
    },
    "readings": {
        "as_read": Variant("as read here", _HARDEST),
        "swept": Variant("contact along the moves", _HARDEST, ProcessConfig(collision="swept")),
        "disk": Variant("targets are disks", _HARDEST, ProcessConfig(target_obstacle="disk")),
        "penalty": Variant(
            "both pay for a failure", _HARDEST, ProcessConfig(partner_of_failed="penalty")
        ),
        "no_update": Variant(
            "partner of a failed robot not updated",
            _HARDEST,
            ProcessConfig(partner_of_failed="none"),
        ),
        "diagonal": Variant("diagonals cost √2", _HARDEST, ProcessConfig(diagonal_cost=2.0**0.5)),
        "slip": Variant("slip 0.2", _HARDEST, ProcessConfig(slip_probability=0.2)),
        "limit200": Variant("step limit 200", _HARDEST, ProcessConfig(step_limit=200)),
        "limit60": Variant("step limit 60", _HARDEST, ProcessConfig(step_limit=60)),
        "eta": Variant("η = 0.001", _HARDEST, learning=LearningConfig(eta=0.001)),
        "linear": Variant("ε linear", _HARDEST, learning=LearningConfig(schedule="linear")),
        "double_q": Variant(
            "double Q-learning", _HARDEST, learning=LearningConfig(algorithm="double_q")
        ),
    },
    "zone": _scenarios(*PAPER, *RESTRICTED),
    "factorial": _factorial(),
    "sequel": {
        f"{name}-{algorithm}": Variant(
            f"{name}, {label}", name, learning=LearningConfig(algorithm=algorithm)
        )
        for name in IN_GROUPS
        for algorithm, label in _ALGORITHMS.items()
    },
}

# What a variant is compared with, run by run (same seed, same run).
REFERENCES: dict[Name, Mapping[str, str]] = {
    "fig10": {name: "c1.5" for name in EXPERIMENTS["fig10"] if name != "c1.5"},
    "features": {name: "xydg" for name in EXPERIMENTS["features"] if name != "xydg"},
    "readings": {name: "as_read" for name in EXPERIMENTS["readings"] if name != "as_read"},
    "zone": {f"{name}-zone": name for name in PAPER},
    "factorial": {
        name: f"{name.rpartition('-')[0]}-c1.5"
        for name in EXPERIMENTS["factorial"]
        if not name.endswith("-c1.5")
    },
    "sequel": {f"{name}-double_q": f"{name}-q" for name in IN_GROUPS},
}
