"""A long run stays as it began: its memory, and what must not move.

Two robots of one endless episode, without speed noise: one drives back and forth, the other drives
to the cell next to it, which is its target, and stands there for the rest.
"""

import contextlib
import resource
from pathlib import Path

import numpy as np
import pytest

from benchmarks.recording import NORTH, NOTHING, SOUTH
from cosim.coupling.rl_step import Decision
from cosim.model.config import CoSimConfig
from cosim.model.params import TIMING
from cosim.model.scenario import Scenario
from cosim.recording.episode import EpisodeRecorder
from cosim.recording.series import with_bursts
from fmus.build import cached_fmu
from tests.alone import CoSimulation

MOST_CHANGE, MOST_CHANGE_RECORDED = 0.05, 0.2  # why the latter: docs/reliability.md
# The first robot never gets to its target, which is not in its column.
SCENARIO = Scenario("endless", "", ((2, 27), (22, 4)), (((7, 4),), ((22, 3),)))
LOW, HIGH = 4, 25  # rows between which it drives
MINUTE_S = 60.0
STANDING_S = 20.0  # after which the second robot is at its target, and at rest


def rss_mb() -> float:
    """Memory that this process has now."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() / 1e6


def endure(time_s: float, most_change: float, recording: Path | None = None) -> None:
    """Simulate an episode of some time, with a recording if a path is given.

    The process may have this share more or less memory than after the first simulated minute.
    """
    timing = TIMING._replace(episode_limit_s=1e9)
    config = with_bursts(CoSimConfig(timing=timing), "default" if recording else "none")
    system = CoSimulation(SCENARIO, cached_fmu(), config.having("given", relative_amplitude=0.0))
    system.compile()
    system.reset()
    steps, heading, values = round(time_s / TIMING.rl_step_s), NORTH, np.zeros((2, 8))
    memory, rest, distance_m = [], None, 0.0
    with contextlib.ExitStack() as stack:
        recorder = recording and stack.enter_context(
            EpisodeRecorder(recording, SCENARIO, system.config, "endurance", {"seed": 0})
        )
        for number in range(steps):
            step = system.step(np.array([heading, NORTH]))
            if recorder is not None:
                recorder.write(step, Decision(step.action, values), NOTHING)
            row = step.after.cells[0, 1]
            heading = SOUTH if row >= HIGH else NORTH if row <= LOW else heading
            distance_m += step.moved_m[0]
            norms = np.linalg.norm(step.samples.quaternion, axis=2)
            assert np.abs(norms - 1.0).max() < 1e-12
            position = step.samples.position[:, 1]
            if number * TIMING.rl_step_s >= STANDING_S:
                rest = position[0] if rest is None else rest
                assert (position == rest).all()
            if (number + 1) * TIMING.rl_step_s % MINUTE_S == 0.0:
                memory.append(rss_mb())
    system.close()
    print(f"{memory[0]:.0f} MB after a minute, {memory[-1]:.0f} MB in the end")
    assert np.abs(np.array(memory) / memory[0] - 1.0).max() < most_change
    assert distance_m > 2e-4 * time_s


@pytest.mark.long
def test_minutes(tmp_path):
    path = tmp_path / "endless.rrd"
    endure(130.0, 0.15, path)  # another library may still be loaded
    assert path.is_file()


@pytest.mark.faults
@pytest.mark.parametrize("recorded", [False, True])
def test_an_hour(tmp_path, recorded):
    if recorded:
        endure(3600.0, MOST_CHANGE_RECORDED, tmp_path / "endless.rrd")
    else:
        endure(3600.0, MOST_CHANGE)
