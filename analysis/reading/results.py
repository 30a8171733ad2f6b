"""Where every result lies in a results folder, and which command puts it there.

The one place that knows the layout: `analysis.figures` draws from it, `analysis.reproduce` fills
it, `analysis.report` links to it. No result is read or made here.
"""

import shlex
from dataclasses import dataclass
from pathlib import Path

from cosim.base.scenario import BUILT_IN

# Episodes of a scenario whose paths Fig. 9 or 12 shows: the paper draws many of one robot on one
# board, and few of a pair.
SINGLE_EPISODES, PAIR_EPISODES = 6, 2


@dataclass(frozen=True)
class Result:
    """A file or folder of results.

    Attributes:
        name: by which figures and people ask for it.
        path: below the results folder; a folder where the command makes several files.
        proof: file below the results folder that is there once the result can be used.
        module: makes it.
        arguments: of the module, without --out.
    """

    name: str
    path: str
    proof: str
    module: str
    arguments: tuple[str, ...] = ()

    def location(self, results: Path) -> Path:
        """Its path in a results folder."""
        return results / self.path

    def proof_in(self, results: Path) -> Path:
        """The file in a results folder that says it is there."""
        return results / self.proof

    def exists(self, results: Path) -> bool:
        """Whether the result can be used."""
        return self.proof_in(results).is_file()

    def argv(self, results: Path) -> list[str]:
        """The command that makes it: what follows `python`."""
        return ["-m", self.module, *self.arguments, "--out", str(self.location(results))]

    def command(self, results: Path) -> str:
        """The command that makes it, as one types it."""
        return shlex.join(["python", *self.argv(results)])


def _experiment(name: str) -> Result:
    folder = f"experiments/{name}"
    return Result(name, folder, f"{folder}/results.json", "agent.experiments", (name,))


def _episodes(scenario: str) -> Result:
    folder = f"episodes/{scenario}"
    count = SINGLE_EPISODES if BUILT_IN[scenario].robots == 1 else PAIR_EPISODES
    arguments = ("--scenario", scenario, "--episodes", str(count), "--jobs", "2")
    return Result(f"episodes_{scenario}", folder, f"{folder}/summary.json", "cosim.run", arguments)


RESULTS: dict[str, Result] = {
    result.name: result
    for result in (
        Result("platform", "platform.npz", "platform.npz", "cosim.platform"),
        Result("motor_test", "motor_test.rrd", "motor_test.rrd", "analysis.motor_test"),
        _experiment("fig08"),
        _experiment("fig10"),
        _experiment("fig11"),
        *(_episodes(scenario) for scenario in BUILT_IN),
        Result("transfer", "transfer", "transfer/transfer.json", "cosim.transfer"),
        Result("calibration", "calibration", "calibration/calibration.npz", "cosim.calibrate"),
    )
}

# Results that a figure is drawn from, by the figure's name, which is that of its files too.
FIGURES: dict[str, tuple[str, ...]] = {
    "fig03": ("platform",),
    "fig05": (),  # the scenarios themselves
    "fig07": ("motor_test",),
    "fig08": ("fig08",),
    "fig09": ("episodes_1a", "episodes_1b"),
    "fig10": ("fig10",),
    "fig11": ("fig11",),
    "fig12": ("episodes_2", "episodes_3", "episodes_4"),
    "motor_cycle": ("episodes_2",),
    "path_ratio": ("fig08", "fig11"),
    "transfer": ("transfer",),
}


def missing(figure: str, results: Path) -> list[Result]:
    """Results that a figure needs and that are not there."""
    return [RESULTS[name] for name in FIGURES[figure] if not RESULTS[name].exists(results)]


def recordings(scenario: str, results: Path) -> list[Path]:
    """Recordings of a scenario's episodes, in their order."""
    return sorted(RESULTS[f"episodes_{scenario}"].location(results).glob("episodes/ep_*.rrd"))
