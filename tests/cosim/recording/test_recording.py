"""Recordings: complete files, the right numbers in them, and honest failures."""

import shutil
import subprocess
import sys
import time
from collections import namedtuple
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
import rerun.blueprint as rrb
from rerun.chunk import RrdReader

from cosim.base.colours import ROBOT_COLOURS, robot_rgba
from cosim.base.errors import FileError, UserError
from cosim.coupling.rl_step import Decision
from cosim.coupling.signals import RawSamples, Samples
from cosim.model.config import CoSimConfig
from cosim.model.params import TABLE_I, TIMING, Mount, motor_names
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_scenario
from cosim.model.world import Patch, World
from cosim.recording.blueprint import episode_blueprint
from cosim.recording.episode import EpisodeRecorder
from cosim.recording.file import Kept, Recording, scalars, simulated
from cosim.recording.reader import read_chunks, read_episode, read_rrd
from cosim.recording.scene import ICE, ROUGH, ink_on, map_colours, shades
from cosim.recording.series import DETAILS, OUTCOME, PolicyMap, Stretch, with_bursts
from cosim.simulation.options import DecisionOptions
from tests.alone import CoSimulation, python, rrd

SCENARIO = Scenario("pair", "two cells each", ((15, 27), (15, 2)), (((15, 29),), ((15, 0),)))
EAST, NORTH, SOUTH = 0, 2, 6
STEPS = 2


def rows(path: Path, entity: str) -> tuple[np.ndarray, np.ndarray]:
    """Times in s and values of a signal."""
    return read_rrd(path).signals[entity][:2]


@pytest.fixture(scope="module")
def recorded(motor_fmu, tmp_path_factory):
    """Two RL steps and their recording."""
    path = tmp_path_factory.mktemp("recording") / "episode.rrd"
    system = CoSimulation(SCENARIO, motor_fmu, with_bursts(CoSimConfig(), "default"))
    system.reset()
    steps = []
    with EpisodeRecorder(path, SCENARIO, system.config, "test", {"seed": 0}) as recorder:
        for number in range(STEPS):
            steps.append(system.step(np.array([SOUTH, NORTH])))
            reward = np.full((2, 3), np.nan)
            if number == 1:
                reward[0] = 0.0, -1.0, -0.5
            values = np.arange(16.0).reshape(2, 8)
            recorder.write(steps[-1], Decision(np.array([7, 7]), values), reward)
    return path, steps


@pytest.mark.skipif(sys.platform != "linux", reason="counts the threads that Linux lists")
def test_a_complete_recording_leaves_no_thread(tmp_path):
    def threads():
        return len([*Path("/proc/self/task").iterdir()])

    with Recording(tmp_path / "first.rrd", "first", None):
        pass
    before = threads()  # with those that Rerun has once
    for number in range(5):
        with Recording(tmp_path / f"{number}.rrd", str(number), None):
            pass
    assert threads() <= before


def test_a_file_that_is_being_written_is_refused(tmp_path):
    path = tmp_path / "a.rrd"
    with Recording(path, "a", None) as file:
        file.properties("of", {"writer": "first"})
        with pytest.raises(FileError, match=r"a\.rrd\.part: another run writes to it; wait"):
            Recording(path, "b", None)
        file.properties("of", {"more": "first"})
    assert read_rrd(path).properties["of"] == {"writer": "first", "more": "first"}


def test_short_rl_steps_have_no_more_bursts(motor_fmu, tmp_path):
    """One in 6 s, however often robots are asked."""
    config = with_bursts(CoSimConfig(), "default").merged(DecisionOptions(rl_step=0.1).tree())
    system = CoSimulation(SCENARIO, motor_fmu, config)
    system.reset()
    path = tmp_path / "episode.rrd"
    with EpisodeRecorder(path, SCENARIO, config, "test", {}) as recorder:
        for _ in range(62):
            recorder.write(system.step(np.array([EAST, EAST])))
    time_s, _ = rows(path, "/raw/r1/normal")
    assert len(time_s) == 2 * round(config.timing.burst_s / config.timing.dt_s)
    assert time_s[[0, len(time_s) // 2]] == pytest.approx([1e-5, 6.0 + 1e-5])
    assert len(rows(path, "/sim/r1/motors/omega")[0]) == 1240


@pytest.mark.parametrize("rl_step_s", [0.1, 2.0])
def test_trails_grow_with_the_time(recorded, rl_step_s):
    """Pieces of 2 s, of which the views show those of the last 10 minutes, for any RL step."""
    step, periods = recorded[1][0], round(1e3 * rl_step_s)
    samples = Samples(*(signal[:periods].copy() for signal in step.samples))
    config = CoSimConfig().merged(DecisionOptions(rl_step=rl_step_s).tree())
    kept, pieces = Kept(), []
    with EpisodeRecorder(kept, SCENARIO, config, "test", {}, level="summary") as recorder:
        for number in range(round(60.0 / rl_step_s)):
            samples.position[:, 0, 0] = 0.05
            samples.position[:, 0, 0] += 1e-6 * (number * periods + np.arange(1, periods + 1))
            at = {"number": number, "first_tick": 100 * number * periods, "duration_s": rl_step_s}
            found = Samples(*(signal.copy() for signal in samples))
            recorder.write(step._replace(samples=found, **at))
    for chunk in kept.chunks:
        batch = chunk.to_record_batch()
        if chunk.entity_path == "/world/r1/trail" and not chunk.is_static:
            pieces += [np.array(row[0]) for row in batch["LineStrips3D:strips"].to_pylist()]
    assert [len(piece) for piece in pieces] == [5] * 30
    track = np.concatenate([piece[1:, 0] for piece in pieces])
    assert track == pytest.approx(0.05 + 1e-3 * 0.5 * np.arange(1, 121), abs=1e-6)
    assert [piece[0, 0] for piece in pieces[1:]] == [piece[-1, 0] for piece in pieces[:-1]]


@pytest.mark.parametrize("lengths", [(1000, 1000), (1000, 77), (77, 1000), (5, 0)])
def test_rows_cover_blocks_also_across_rl_steps(recorded, lengths):
    steps, every = recorded[1], 25
    cut = [
        step._replace(samples=Samples(*(field[:length] for field in step.samples)))
        for step, length in zip(steps, lengths, strict=True)
    ]
    voltage = np.concatenate([step.samples.voltage for step in cut])
    blocks = np.split(voltage, np.arange(every, len(voltage), every))
    stretch = Stretch(cut, TIMING)
    ways: dict[Literal["mean", "max"], Any] = {"mean": np.mean, "max": np.max}
    for how, of_block in ways.items():
        rows = stretch.rows(lambda samples: samples.voltage, every, how)
        assert rows == pytest.approx(np.array([of_block(block, axis=0) for block in blocks]))
    last = stretch.rows(lambda samples: samples.voltage, every, "last")
    assert np.array_equal(last, [block[-1] for block in blocks])
    first = np.concatenate(
        [np.arange(min(9, n)) + begin for n, begin in zip(lengths, (0, lengths[0]), strict=True)]
    )
    assert np.array_equal(stretch.bursts(9), first)


def test_a_file_is_complete_and_its_bursts_hold_every_tick(recorded):
    path, steps = recorded
    assert rrd("verify", path)
    assert not path.with_name("episode.rrd.part").exists()
    time_s, values = rows(path, "/raw/r2/normal")
    assert np.array_equal(values, steps[0].raw.normal[:, 1])
    assert np.diff(time_s) == pytest.approx(1e-5)
    episode = read_episode(path)
    assert not any("estimate" in signal for signal in episode.signals)  # without a camera
    assert (episode.outcome, episode.texts[OUTCOME].texts) == ("", ("running",))


@pytest.mark.parametrize(
    ("level", "values"), [("summary", True), ("default", True), ("full", True), ("default", False)]
)
def test_every_path_of_the_blueprint_is_recorded(recorded, shown_paths, level, values):
    """Views of a missing entity stay empty without a word."""
    _, steps = recorded
    kept = Kept()
    config = CoSimConfig(timing=TIMING._replace(burst_s=DETAILS[level].burst_s))
    maps = [PolicyMap(np.eye(30), np.eye(30, dtype=int), np.eye(30))] * 2 * values
    if level == "summary":
        steps = [step._replace(raw=RawSamples(*(v[:0] for v in step.raw))) for step in steps]
    with EpisodeRecorder(
        kept, SCENARIO, config, "test", {"seed": 0}, level=level, policies=maps
    ) as recorder:
        for step in steps:
            decision = Decision(step.action, np.zeros((2, 8)) if values else None)
            recorder.write(step, decision, np.zeros((2, 3)) if values else None)
    paths = shown_paths(kept.blueprint)
    assert len(paths) > (20 if level == "summary" else 26)
    for static in (True, False):  # styles are, of signals without a row too
        entities = {c.entity_path for c in kept.chunks if static or not c.is_static}
        missing = {p for p in paths if not any(e == p or e.startswith(p + "/") for e in entities)}
        if static:
            assert not missing
    # The tab on learning stays, for values that a policy without maps may have.
    unsaid = {"failure"} if values else {"failure", "q_s", "greedy"}
    assert missing - {"/info/run"} == {
        f"/rl/r{robot}/{name}" for robot in (1, 2) for name in unsaid
    }


def static_boxes(path: Path, entity: str) -> dict[str, np.ndarray]:
    (chunk,) = (c for c in RrdReader(str(path)).stream() if c.entity_path == entity)
    columns = chunk.to_record_batch().to_pydict()
    return {
        name.partition(":")[2]: np.array(rows[0])
        for name, rows in columns.items()
        if name.startswith("Boxes3D:")
    }


def test_obstacles_and_patches_are_drawn_where_they_are(tmp_path):
    world = World(mu_patches=(Patch((4, 5, 12, 26), 0.22), Patch((18, 2, 18, 2), 0.12)))
    scenario, path = find_scenario("5-slalom"), tmp_path / "episode.rrd"
    with EpisodeRecorder(path, scenario, replace(CoSimConfig(), world=world), "test", {"seed": 0}):
        pass
    found = static_boxes(path, "/world/obstacles")
    centres, halves = found["centers"], found["half_sizes"]
    boxes = np.hstack([centres - halves, centres + halves])
    assert boxes[:, [0, 1, 3, 4]] == pytest.approx(0.01 * scenario.walls, abs=1e-6)
    assert boxes[:, 2] == pytest.approx(0.0)  # they stand on the floor
    assert (boxes[:, 5] > 0.0).all()
    patches = static_boxes(path, "/world/patches")
    assert patches["labels"].tolist() == ["µ 0.22", "µ 0.12"]
    assert patches["colors"].tolist() == [ROUGH, ICE]
    assert patches["centers"][:, :2] == pytest.approx(np.array([[0.085, 0.16], [0.185, 0.025]]))


def test_an_error_leaves_a_readable_recording(motor_fmu, tmp_path):
    path = tmp_path / "failed.rrd"
    system = CoSimulation(SCENARIO, motor_fmu)
    system.reset()
    with (
        pytest.raises(UserError, match="expected 2 integers"),
        EpisodeRecorder(path, SCENARIO, system.config, "test", {"seed": 0}) as recorder,
    ):
        step = system.step(np.array([SOUTH, NORTH]))
        recorder.write(step, Decision(step.action, np.zeros((2, 8))))
        system.step(np.array([SOUTH]))
    assert rrd("verify", path)
    assert len(rows(path, "/sim/r1/motors/omega")[0]) == 400


def test_full_disk_is_told_before_data_is_lost(tmp_path, monkeypatch):
    path = tmp_path / "full.rrd"
    with Recording(path, "test", None) as file:
        file.columns("/sim/r1/heading", simulated(np.array([1.0])), scalars(np.array([0.5])))
        usage = namedtuple("usage", "total used free")
        monkeypatch.setattr(shutil, "disk_usage", lambda _: usage(1, 1, 1000))
        with pytest.raises(UserError, match="free some space"):
            file.check_space()
    assert rrd("verify", path)


# Episodes of a file each that never end: an RL step of two robots over and over, recorded as if it
# went on. Files may not grow beyond a limit, as on a full disk; or it is set when an episode ends.
ENDLESS = """
import resource, sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
import numpy as np
from cosim.base.errors import run_command
from cosim.model.config import CoSimConfig
from cosim.recording import file as recording
from cosim.recording.episode import EpisodeRecorder
from cosim.recording.series import with_bursts
from cosim.simulation.batch import Batch
from fmus.build import cached_fmu
from tests.cosim.recording.test_recording import NORTH, SCENARIO, SOUTH

recording.FLUSH_TIMEOUT_S = 3.0
size, paths = int(sys.argv[1]), [Path(path) for path in sys.argv[2:]]

def limit(size):
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))

def record(path):
    with EpisodeRecorder(path, SCENARIO, system.config, "test", {}) as recorder:
        for number in range(10_000 if size else 40):
            recorder.write(step._replace(number=number, first_tick=number * 200_000))
        if not size:
            limit(path.with_name(path.name + ".part").stat().st_size + 10)

system = Batch(cached_fmu(), with_bursts(CoSimConfig(), "default"), 2, 1)
system.begin(0, SCENARIO, tuple(c[0] for c in SCENARIO.starts), np.random.SeedSequence(0))
step = system.advance({0: np.array([SOUTH, NORTH])})[0]
if size:
    limit(size)
with ThreadPoolExecutor(len(paths)) as threads:
    run_command(lambda: list(threads.map(record, paths)))
"""


@pytest.mark.long
@pytest.mark.parametrize(
    ("megabytes", "names"),
    [(0.3, ["a"]), (30.0, ["a"]), (3.0, ["a", "b"]), (0.0, ["a"])],
    ids=["at the beginning", "later", "two at once", "at the end"],
)
def test_full_disk_ends_in_one_sentence_and_no_file_by_its_name(tmp_path, megabytes, names):
    """The thread that writes has the error, the episode ends with it."""
    paths = [tmp_path / f"{name}.rrd" for name in names]
    done = python("-c", ENDLESS, round(1e6 * megabytes), *paths, timeout=300)
    assert done.returncode == 2, done.stderr
    assert "File too large" in done.stderr  # what Rerun says of it
    assert done.stderr.count("error: ") == 1
    part = tmp_path / "a.rrd.part"
    assert f"error: the recording {part} could not be written out (" in done.stderr
    assert sorted(file.name for file in tmp_path.iterdir()) == [f"{n}.rrd.part" for n in names]
    if megabytes != 0.3:
        rows = 20_000 if megabytes == 30.0 else 400
        assert len(read_rrd(part).signals["/sim/r1/motors/omega"].time_s) >= rows


@pytest.mark.long
def test_what_a_killed_episode_wrote_can_be_read(tmp_path):
    """Killed while a stretch is written: the one before it is whole."""
    path = tmp_path / "a.rrd"
    part = tmp_path / "a.rrd.part"
    command = [sys.executable, "-c", ENDLESS, str(10**9), path]
    with subprocess.Popen(command) as process:
        while not part.exists() or part.stat().st_size < 12_000_000:
            assert process.poll() is None
            time.sleep(0.01)
        process.kill()
    episode = read_episode(part)
    assert not episode.complete
    omega, position = (episode.signals[f"r1/{name}"] for name in ("motors/omega", "position"))
    assert len(omega.time_s) % 4000 == 0  # of 20 s
    assert omega.time_s[-1] == pytest.approx(5e-3 * len(omega.time_s))
    assert position.time_s[-1] > omega.time_s[-1] - 60.001  # a minute is lost at most


def test_rows_between_two_flushes_are_one_chunk(tmp_path):
    """Rerun keeps an index of all chunks in memory."""
    path, entity = tmp_path / "episode.rrd", "/sim/r1/heading"
    time_s = np.arange(0.0, 6.0)
    with Recording(path, "test", None) as file:
        for block in (time_s[:1], time_s[1:3], time_s[3:]):
            file.columns(entity, simulated(block, block.astype(int).tolist()), scalars(2.0 * block))
    (chunk,) = (c for c in RrdReader(str(path)).stream() if c.entity_path == entity)
    assert np.array_equal(chunk.to_record_batch().column("rl_step").to_numpy(), time_s)
    found_s, values = rows(path, entity)
    assert np.array_equal(found_s, time_s)
    assert np.array_equal(values.ravel(), 2.0 * time_s)


@pytest.mark.parametrize("values", [np.zeros(0), np.zeros((0, 2)), np.arange(6.0).reshape(3, 2)])
def test_signals_may_be_empty(tmp_path, values):
    path = tmp_path / "episode.rrd"
    with Recording(path, "test", None) as file:
        file.columns("/sim/r1/heading", simulated(np.arange(float(len(values)))), scalars(values))
    assert rrd("verify", path)
    assert len(read_rrd(path).signals["/sim/r1/heading"].values) == len(values)


@pytest.mark.parametrize("named", [False, True])
def test_recording_without_a_first_signal_is_refused_in_one_sentence(tmp_path, named):
    path = tmp_path / "episode.rrd"
    with Recording(path, "test", None) as file:
        file.properties("episode", {"seed": 0})
        if named:
            file.columns("/sim/r1/heading", simulated(np.zeros(0)), scalars(np.zeros(0)))
    with pytest.raises(match="ends before the first signals of its episode"):
        read_episode(path)


def test_unwritable_folder_is_named():
    with pytest.raises(OSError, match="/proc"):
        Recording(Path("/proc/none/x.rrd"), "test", None)


def test_run_page_lists_every_parameter_with_its_source(recorded):
    (chunk,) = (c for c in RrdReader(str(recorded[0])).stream() if c.entity_path == "/info/run")
    text = chunk.to_record_batch().to_pydict()["TextDocument:text"][0][0]
    for name, row in CoSimConfig().table().items():
        assert f"| {name} |" in text
        assert row["source"] in text


def test_properties_keep_numbers_and_write_the_rest_as_json():
    """Also where an earlier recording of this process had another type."""
    for seed in (3, 0.5, (3, 1), 2**62, "three", True):
        kept = Kept()
        kept.properties("of", {"seed": seed, "starts": ((1, 2),)})
        kept_seed = "[3, 1]" if isinstance(seed, tuple) else seed
        found = read_chunks(kept.chunks, "").properties["of"]
        assert found == {"seed": kept_seed, "starts": "[[1, 2]]"}


def test_the_outcome_stands_above_the_board_from_the_start(recorded):
    _, steps = recorded
    kept = Kept()
    with EpisodeRecorder(kept, SCENARIO, CoSimConfig(), "test", {"seed": 0}) as recorder:
        recorder.write(steps[0])
        recorder.write(steps[1]._replace(outcome="timeout"))
    found = [c.to_record_batch() for c in kept.chunks if c.entity_path == "/world/outcome"]
    labels = [label for rows in found for label in rows.column("Points3D:labels").to_pylist()]
    assert labels == [["running"], ["timeout"]]
    times = [t for rows in found for t in rows.column("sim_time").cast("int64").to_pylist()]
    assert times == [0, 4_000_000_000]


def test_a_robot_has_one_colour_in_every_view():
    """Signals have shades of the robot's colour, which no other robot has."""
    seen = [{*shades(robot_rgba(robot), 3).tolist()} for robot in range(len(ROBOT_COLOURS))]
    assert all(robot_rgba(robot) in colours for robot, colours in enumerate(seen))
    assert len(set.union(*seen)) == 3 * len(ROBOT_COLOURS)


def views_of(part: Any) -> list[rrb.TimeSeriesView]:
    if isinstance(part, rrb.TimeSeriesView):
        return [part]
    children = getattr(part, "contents", ())
    return [view for child in children if child is not part for view in views_of(child)]


@pytest.mark.parametrize("motors", range(1, 9))
def test_plots_say_which_curve_is_which_motor(motors):
    """By tints from dark to light, and by a legend where there are too many for them."""
    mounts = (Mount((0.0, 0.0, 0.003), (0.0, 1.0, 0.0)),) * motors
    names, tints = motor_names(motors), shades(robot_rgba(0), motors).tolist()
    by_tint = motors < 4
    listed = [name for _, name in sorted(zip(tints, names, strict=True))] if by_tint else names
    expected = ", ".join(listed).replace("D", "D (dark)" if by_tint and motors > 1 else "D")
    blueprint = episode_blueprint(1, (0.3, 0.3), machine=TABLE_I._replace(motors=mounts))
    views = views_of(blueprint.root_container)
    plots = [view for view in views if "/sim/r1/motors/" in str(view.contents)]
    assert {view.name for view in plots} == {
        f"speed of {expected}, set points (white), rad/s · r1",
        f"voltage of {expected}, V · r1",
        f"current of {expected}, A · r1",
    }
    legends: list[Any] = [view.properties["PlotLegend"] for view in plots]
    shown = [legend.visible.as_arrow_array().to_pylist() for legend in legends]
    assert shown == [[not by_tint]] * len(plots)


def test_arrows_of_a_policy_are_seen_on_every_value():
    """WCAG asks for a contrast of 3 between lines and what is behind them."""
    floor = map_colours(np.linspace(0.0, 1.0, 256)[None], np.ones((1, 256), bool))[0]
    lines = ink_on(floor)[:, None] >> np.array([24, 16, 8], dtype=np.uint32) & 0xFF
    pair = np.sort([_luminance(floor), _luminance(lines)], axis=0) + 0.05
    assert (pair[1] / pair[0]).min() > 3.0


def _luminance(colours: np.ndarray) -> np.ndarray:
    """Relative luminance of sRGB colours (n, 3)."""
    share = colours / 255.0
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    return linear @ (0.2126, 0.7152, 0.0722)
