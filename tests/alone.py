"""Helpers of many tests: single episodes, equal signals, edited archives, and processes."""

import subprocess
import sys
import zipfile
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from cosim.coupling.rl_step import Step, SupportsAct, decide
from cosim.fmi.motor import with_motor
from cosim.model.config import CoSimConfig
from cosim.model.scenario import Cell, Scenario
from cosim.onboard.features import Observation
from cosim.simulation.batch import Batch
from cosim.simulation.episode import RunningEpisode


class CoSimulation(Batch):
    """Robots, motors and floor of one scenario; by default with the default parameters."""

    episode: RunningEpisode

    def __init__(
        self, scenario: Scenario, fmu: Path, config: CoSimConfig | None = None, **how: Any
    ) -> None:
        self.scenario = scenario
        config = with_motor(config or CoSimConfig().sized(scenario.diameter_m), fmu)
        super().__init__(fmu, config, scenario.robots, 1, **how)

    def reset(
        self, starts: tuple[Cell, ...] = (), seed: np.random.SeedSequence | int = 0
    ) -> Observation:
        """Begin an episode, by default from the first start of each robot."""
        starts = starts or tuple(cells[0] for cells in self.scenario.starts)
        seed = np.random.SeedSequence(seed) if isinstance(seed, int) else seed
        self.episode = self.begin(0, self.scenario, starts, seed)
        return self.episode.observation

    def step(self, action: np.ndarray) -> Step:
        return self.advance({0: action})[0]


class Constant:
    """Drives every robot in its direction, always."""

    def __init__(self, *directions: int) -> None:
        self._directions = np.array(directions)

    def act(self, observation: Observation) -> np.ndarray:
        return self._directions


def edited(original: Path, path: Path, edit: Callable[[str, bytes], str | bytes | None]) -> Path:
    """Copy an archive; of each entry, by name and content, return the new content or None."""
    with zipfile.ZipFile(original) as archive, zipfile.ZipFile(path, "w") as copy:
        for name in archive.namelist():
            content = edit(name, archive.read(name))
            if content is not None:
                copy.writestr(name, content)
    return path


def python(
    *arguments: object, text: bool = True, check: bool = False, **options: Any
) -> subprocess.CompletedProcess[Any]:
    """Run Python with these arguments to its end: its status, and what it said."""
    command = [sys.executable, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=text, check=check, **options)


def lives(pid: int) -> bool:
    """Return whether a process runs, on Linux; a zombie has ended."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def started(*arguments: object, **options: Any) -> tuple[subprocess.Popen[str], str]:
    """Start Python with these arguments: the process, and the first line that it prints."""
    how: Any = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True} | options
    process = subprocess.Popen([sys.executable, *map(str, arguments)], **how)
    assert process.stdout is not None
    return process, process.stdout.readline()


def rrd(*arguments: str | Path) -> bool:
    """Whether `rerun rrd` succeeds with these arguments."""
    command = [Path(sys.executable).with_name("rerun"), "rrd", *arguments]
    return not subprocess.run(command, capture_output=True, check=False).returncode


def same(ours: Iterable[Any], theirs: Iterable[Any]) -> bool:
    """Whether signals are equal, one by one."""
    return all(np.array_equal(a, b) for a, b in zip(ours, theirs, strict=True))


def drive(
    scenario: Scenario, fmu: Path, policy: SupportsAct, config: CoSimConfig | None = None
) -> tuple[CoSimulation, list[Step]]:
    """Simulate an episode until its end, and return its RL steps."""
    system, steps = CoSimulation(scenario, fmu, config), []
    system.reset()
    while not system.episode.outcome:
        steps.append(system.step(decide(policy, system.episode.observation).action))
    system.close()
    return system, steps
