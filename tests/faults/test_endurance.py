"""A long run stays as it began: its memory, its cost, and what must not move.

Two robots of one endless episode, without speed noise: one drives back and forth, the other drives
to the cell next to it, which is its target, and stands there for the rest.
"""

import contextlib
import resource
import time
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


def endure(time_s: float, seed: int, recording: Path | None) -> dict[str, float]:
    """One episode of so much simulated time, with a recording if a path is given.

    Memory of the process after the first simulated minute and its largest change from then on, as
    a share; processor time of the last quarter over that of the first; path of the first robot,
    and how far the second one moved from where it came to rest; largest difference of the norm of
    an orientation from 1.
    """
    timing = TIMING._replace(episode_limit_s=1e9)
    config = with_bursts(CoSimConfig(timing=timing), "default" if recording else "none")
    system = CoSimulation(SCENARIO, cached_fmu(), config.having("given", relative_amplitude=0.0))
    system.compile()
    starts = tuple(cells[0] for cells in SCENARIO.starts)
    system.reset(starts, np.random.SeedSequence(seed))
    steps, heading, values = round(time_s / TIMING.rl_step_s), NORTH, np.zeros((2, 8))
    costs, memory, rest = np.zeros(steps), [], np.full(3, np.nan)
    distance_m = moved_m = error = 0.0
    with contextlib.ExitStack() as stack:
        facts = {"seed": seed}
        recorder = recording and stack.enter_context(
            EpisodeRecorder(recording, SCENARIO, system.config, "endurance", facts)
        )
        for number in range(steps):
            began = time.process_time()
            step = system.step(np.array([heading, NORTH]))
            if recorder is not None:
                recorder.write(step, Decision(step.action, values), NOTHING)
            costs[number] = time.process_time() - began
            row = step.after.cells[0, 1]
            heading = SOUTH if row >= HIGH else NORTH if row <= LOW else heading
            distance_m += step.moved_m[0]
            norms = np.linalg.norm(step.samples.quaternion, axis=2)
            error = max(error, float(np.abs(norms - 1.0).max()))
            position = step.samples.position[:, 1]
            if number * TIMING.rl_step_s >= STANDING_S:
                rest = position[0] if np.isnan(rest).all() else rest
                moved_m = max(moved_m, float(np.linalg.norm(position - rest, axis=1).max()))
            if (number + 1) * TIMING.rl_step_s % MINUTE_S == 0.0:
                memory.append(rss_mb())
    system.close()
    quarter = steps // 4
    return {
        "simulated_s": steps * TIMING.rl_step_s,
        "rss_mb": memory[0],
        "rss_change": float(np.abs(np.array(memory) / memory[0] - 1.0).max()),
        "cost_ratio": float(costs[-quarter:].sum() / costs[:quarter].sum()),
        "distance_m": float(distance_m),
        "standing_moved_m": moved_m,
        "quaternion_error": error,
    }


def judge(found: dict[str, float], most_change: float) -> None:
    assert found["rss_change"] < most_change
    assert found["standing_moved_m"] == 0.0
    assert found["quaternion_error"] < 1e-12
    assert found["distance_m"] > 2e-4 * found["simulated_s"]
    assert found["cost_ratio"] > 0.0


@pytest.mark.long
def test_minutes(tmp_path):
    path = tmp_path / "endless.rrd"
    judge(endure(130.0, 0, path), 0.15)  # another library may still be loaded
    assert path.is_file()


@pytest.mark.faults
@pytest.mark.parametrize("recorded", [False, True])
def test_an_hour(tmp_path, recorded, record_property):
    found = endure(3600.0, 0, tmp_path / "endless.rrd" if recorded else None)
    print(found)
    record_property("hours", found["simulated_s"] / 3600.0)
    judge(found, MOST_CHANGE_RECORDED if recorded else MOST_CHANGE)
