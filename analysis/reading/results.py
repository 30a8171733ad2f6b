"""Places of results in a results folder, and the commands that write them.

The one place that knows the layout and the order: `minirobots reproduce` fills it, figures and the
report read from it. Their writers own the content of results.
"""

import shlex
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from analysis.profiles import FULL, SEQUEL_EPISODES
from cosim.base.errors import UserError
from cosim.base.reading import Kind, read_json
from cosim.model.scenario_file import PAPER, find_scenario

if TYPE_CHECKING:
    from agent.experiments.results import ExperimentResult

# Methods of the policies that drive them, from the same starts and noise: the paper's, and
# the one that learns on moves observed in the co-simulation.
DRIVEN_BY = ("paper", "moves")


@dataclass(frozen=True)
class Result:
    """A file or folder of results."""

    name: str  # by which figures and people ask for it
    title: str  # what is done to get it
    path: str  # below the results folder; a folder where the command makes several files
    maker: str  # command of `minirobots` that makes it
    # File below the path that is there once the result can be used, if it is a folder
    proof: str = ""
    of: str = ""  # experiment or scenario, where the command makes several
    method: str = ""  # by which the policy of a run is made
    arguments: tuple[str, ...] = ()  # of the command for the full amount, without --out

    def location(self, results: Path) -> Path:
        """Return its path in a results folder."""
        return results / self.path

    def proof_in(self, results: Path) -> Path:
        """Return the file in a results folder that proves that the result exists."""
        return self.location(results) / self.proof

    def exists(self, results: Path) -> bool:
        """Return whether the result can be used."""
        return self.proof_in(results).is_file()

    def command(self, results: Path) -> str:
        """The command that makes it, as one types it."""
        arguments = (*self.arguments, "--out", str(self.location(results)))
        return shlex.join(["minirobots", self.maker, *arguments])


def _experiment(name: str, title: str, *arguments: str) -> Result:
    path, given = f"experiments/{name}", (name, *arguments)
    return Result(name, title, path, "experiments", "results.json", name, arguments=given)


def episodes_of(scenario: str, method: str) -> str:
    """Return the name of the result with a scenario's episodes under a method's policy."""
    return f"episodes_{scenario}_{method}"


def _episodes(scenario: str, method: str) -> Result:
    folder, alone = f"episodes/{scenario}-{method}", find_scenario(scenario).robots == 1
    title = f"scenario {scenario} co-simulated, method {method} (Fig. {9 if alone else 12})"
    count = str(FULL.single_episodes if alone else FULL.pair_episodes)
    arguments = ("--scenario", scenario, "--method", method, "--episodes", count, "--jobs", "2")
    name = episodes_of(scenario, method)
    return Result(name, title, folder, "run", "summary.json", scenario, method, arguments)


# In the order of being made: the quick ones first, so that a mistake shows early.
RESULTS: dict[str, Result] = {
    result.name: result
    for result in (
        Result(
            "platform", "platform of one degree of freedom (Fig. 3)", "platform.npz", "platform"
        ),
        Result(
            "motor_test", "motor in open and closed loop (Fig. 7)", "motor_test.rrd", "motor-test"
        ),
        Result(
            "calibration", "calibration of speeds", "calibration", "calibrate", "calibration.npz"
        ),
        *(_episodes(scenario, method) for scenario in PAPER for method in DRIVEN_BY),
        _experiment("fig08", "training of one robot (Fig. 8)"),
        _experiment("fig11", "training of pairs (Fig. 11)"),
        _experiment("fig10", "training with values of c (Fig. 10)"),
        Result(
            "transfer",
            "success in co-simulation",
            "transfer",
            "study",
            "study.json",
            arguments=("docs/studies/methods.toml",),
        ),
        _experiment("sequel", "training of groups (sequel)", "--episodes", str(SEQUEL_EPISODES)),
    )
}


def missing(names: Iterable[str], results: Path) -> list[Result]:
    """Return the results, of some names, that a folder lacks."""
    return [RESULTS[name] for name in names if not RESULTS[name].exists(results)]


def recordings(name: str, results: Path) -> list[Path]:
    """Return the recordings of a result's episodes, in their order; refuse if there are none."""
    found = sorted(RESULTS[name].location(results).glob("episodes/ep_*.rrd"))
    if not found:
        raise UserError(f"{name}: no recordings; run `{RESULTS[name].command(results)}` first")
    return found


def read_result(name: str, results: Path, form: Any) -> Any:
    """Return a result's JSON file as a record of a type."""
    result = RESULTS[name]
    kind = Kind(f"result of `minirobots {result.maker}`", f"run `{result.command(results)}`")
    return read_json(result.proof_in(results), kind, form)


def read_experiment(name: str, results: Path) -> "ExperimentResult":
    """Description of an experiment by `minirobots experiments`; refuse that of another one."""
    from agent.experiments.results import ExperimentResult  # noqa: PLC0415 - slow to import

    content = read_result(name, results, ExperimentResult)
    if content.experiment != name:
        result = RESULTS[name]
        raise UserError(
            f"{result.proof_in(results)}: not a result of {name}; run `{result.command(results)}`"
        )
    return content
