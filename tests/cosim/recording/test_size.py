"""What recordings weigh, as it is said before they are written."""

import logging
import re

import numpy as np
import pytest
import rerun as rr
from rerun.chunk import Chunk

from cosim.model.config import CoSimConfig
from cosim.recording.file import Recording, scalars, simulated
from cosim.recording.reader import read_rrd
from cosim.recording.series import LARGE_MB, bytes_per_s, warn_of_size
from cosim.simulation.simulate import simulate


class There:
    """Drives back and forth."""

    def act(self, observation):
        return np.full(len(observation.cells), 4 * (observation.cells[0, 0] % 2))


@pytest.mark.long
@pytest.mark.parametrize(("level", "times_s"), [("summary", (4, 24)), ("default", (4, 24))])
def test_a_recording_weighs_what_is_said_before(level, times_s, tmp_path):
    sizes = []
    for time_s in times_s:
        how = {"record": level, "on_collision": "continue", "progress": None}
        episode = simulate("2", There(), time_limit=float(time_s), **how)
        episode.save(path := tmp_path / f"{time_s}.rrd")
        sizes.append(path.stat().st_size)
    measured = (sizes[1] - sizes[0]) / (times_s[1] - times_s[0])
    assert bytes_per_s(CoSimConfig(), level, 2) == pytest.approx(measured, rel=0.35)


def test_large_recordings_are_announced_with_what_makes_them_smaller(caplog):
    usual = CoSimConfig()
    slow = usual.having("given", episode_limit_s=6000.0)
    with caplog.at_level(logging.WARNING):
        warn_of_size(usual, "default", 2)
        warn_of_size(slow, "summary", 2)
        assert not caplog.records
        warn_of_size(slow, "default", 2)
    (text,) = caplog.messages
    assert text.startswith("the recording of an episode can become 749 MB")
    assert "(6000 s at most)" in text and "--record summary" in text
    smaller = re.search(r"makes it (\d+) MB", text)
    assert smaller is not None and float(smaller[1]) < LARGE_MB


def test_a_recording_is_read_chunk_by_chunk_and_without_what_is_not_needed(tmp_path):
    """In any order of its chunks, with rows that have no value."""
    path, times = tmp_path / "a.rrd", np.arange(6.0)
    with Recording(path, "test", None) as file:
        for part in ([4, 5], [0, 1], [2, 3]):
            for entity in ("/sim/r1/speed", "/world/r1/speed"):
                chunk = Chunk.from_columns(
                    entity, simulated(times[part]), scalars(times[part] ** 2)
                )
                file.send([chunk])
            states = rr.StateChange.columns(state=[f"at {k}" for k in part])
            file.send([Chunk.from_columns("/rl/r1/move", simulated(times[part]), states)])
        empty = rr.Scalars.columns(scalars=[]).partition([0])
        file.send([Chunk.from_columns("/sim/r1/speed", simulated(times[:1]), empty)])
    whole, some = read_rrd(path), read_rrd(path, without=("/world/**",))
    assert whole.signals.keys() - some.signals.keys() == {"/world/r1/speed"}
    for data in (whole, some):
        speed = data.signals["/sim/r1/speed"]
        assert (speed.time_s.tolist(), speed.values.tolist()) == (times.tolist(), [*times**2])
        assert data.texts["/rl/r1/move"].texts == tuple(f"at {k}" for k in range(6))
