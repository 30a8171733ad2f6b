"""Whatever stands in a file, its reader gives a result or one sentence.

What damage does to policies, curves, moves and captions is tested with their readers
in `tests/agent/test_reading.py`.
"""

import json
import re
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.mdp.config import ProcessConfig
from agent.mdp.readings import build_process
from agent.training.learning import build_learning
from agent.training.settings import LearningConfig, read_settings
from analysis.timings import read_timings
from cosim.base.errors import UserError
from cosim.fmi.motor import Motor, MotorFmu
from cosim.machine.identification.track import COLUMNS, read_track
from cosim.model.config import CoSimConfig
from cosim.model.params import MotorParams, RobotParams
from cosim.model.preset import FIELDS, find_preset
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_in_world, in_world, read_world
from cosim.model.world import Sensor, World
from cosim.recording.blueprint import episode_blueprint
from cosim.recording.file import Recording, scalars, simulated
from cosim.recording.reader import read_rrd
from tests.faults.fuzzing import examples

SMALL = Scenario(
    "small", "", ((4, 0),), (((0, 0),),), 5, 5, robot_diameter_m=0.01, zone=(2, 2, 3, 3)
)


def one_sentence(read: Callable[[], Any]) -> None:
    try:
        read()
    except UserError as error:
        assert str(error)
        assert "\n" not in str(error)


NUMBERS = st.one_of(
    st.integers(-3, 40),
    st.sampled_from((0.0, 0.05, 1e-320, 1e300, 1e9, -1.0, float("inf"), float("nan"))),
    st.floats(allow_subnormal=True),
    st.integers(-(2**70), 2**70),
    st.sampled_from((10**400, 2**63, -(2**63), 500, 501)),
)
ATOMS = st.one_of(
    NUMBERS, NUMBERS, st.booleans(), st.text(max_size=5), st.sampled_from(("top", "q", "x", "cell"))
)
VALUES = st.recursive(
    ATOMS, lambda inner: st.lists(inner, max_size=5) | st.lists(NUMBERS, max_size=4), max_leaves=12
)


def table(*names: str) -> st.SearchStrategy[dict[str, Any]]:
    """A table with some of the fields that its reader knows, sometimes another one."""
    keys = st.sampled_from((*names, *names, "colour", ""))
    return st.dictionaries(keys, VALUES, max_size=4)


def toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(k)} = {toml(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    if isinstance(value, int) and not isinstance(value, bool):
        return hex(value) if value > 10**300 else str(value)  # no limit of digits
    return json.dumps(value).replace("Infinity", "inf").replace("NaN", "nan")


def lines(content: dict[str, Any]) -> str:
    return "".join(f"{json.dumps(k)} = {toml(v)}\n" for k, v in content.items())


def names_of(record: type) -> tuple[str, ...]:
    return tuple(record.__annotations__)


def optional_table(table_: st.SearchStrategy[Any], name: str) -> st.SearchStrategy[dict[str, Any]]:
    """A table below a name, or nothing, or no table."""
    return st.one_of(
        st.just({}), st.builds(lambda t: {name: t}, table_), st.builds(lambda v: {name: v}, VALUES)
    )


SENSOR = optional_table(table(*names_of(Sensor)), "sensor")
WORLD = st.builds(lambda a, b: a | b, table(*names_of(World)), SENSOR)
CELLS = st.lists(st.lists(st.integers(-1, 12), max_size=4), max_size=6) | st.just("top")
ROBOT = st.builds(
    lambda target, starts, more: {"target": target, "starts": starts} | more,
    st.lists(st.integers(-1, 12), min_size=2, max_size=2) | VALUES,
    CELLS | VALUES,
    st.just({}) | table("target", "starts"),
)
BOARD = st.sampled_from(
    ({"columns": 12, "rows": 12}, {"columns": 500, "rows": 3, "cell_m": 0.1}, {"cell_m": 0.05})
)
SCENARIO = st.builds(
    lambda board, robots, more, world: board | {"robots": robots} | more | world,
    BOARD,
    st.lists(ROBOT, max_size=4),
    st.just({})
    | table("columns", "rows", "cell_m", "zone", "obstacles", "robot_diameter_m", "name"),
    optional_table(WORLD, "world"),
)
PRESET = st.builds(
    lambda *parts: {k: v for some in parts for k, v in some.items()},
    optional_table(table(*RobotParams._fields, "source"), "robot"),
    optional_table(table(*MotorParams._fields, "source"), "motor"),
    optional_table(
        st.builds(lambda a, b: a | b, table(*FIELDS["world"], "source"), SENSOR), "world"
    ),
    st.just({}) | table("source"),
)
SETTINGS = st.builds(
    lambda *parts: {k: v for some in parts for k, v in some.items()},
    optional_table(table(*names_of(ProcessConfig)), "process"),
    optional_table(table(*names_of(LearningConfig)), "learning"),
)


def scenario_of(path: Path) -> None:
    scenario, world = find_in_world(path)
    build_process(scenario, ProcessConfig())
    CoSimConfig().in_world(world).sized(scenario.diameter_m)


def world_of(path: Path) -> None:
    world = read_world(path)
    in_world(SMALL, world)
    CoSimConfig().in_world(world)


def preset_of(path: Path) -> None:
    preset, again = find_preset(path), path.with_name("again.toml")
    preset.config().sized(0.05)
    preset.save(again)
    assert find_preset(again).tree == preset.tree


def settings_of(path: Path) -> None:
    process, learning = read_settings(path)
    build_process(SMALL, process)
    if learning.episodes <= 10**6:
        build_learning(learning)


TABLES = {
    scenario_of: SCENARIO,
    world_of: st.builds(lambda world: {"world": world}, WORLD) | optional_table(WORLD, "world"),
    preset_of: PRESET,
    settings_of: SETTINGS,
}


@pytest.mark.parametrize("use", TABLES)
@examples(40)
@given(data=st.data())
def test_tables(tmp_path, use, data):
    path = tmp_path / "mine.toml"
    path.write_text(lines(data.draw(TABLES[use])), encoding="utf-8")
    one_sentence(lambda: use(path))


FIELDS = st.one_of(st.floats(width=32).map(str), st.text(max_size=4), st.just("0"))
TRACKS = st.lists(st.lists(FIELDS, max_size=7), max_size=6)


@examples(40)
@given(
    rows=TRACKS, frames=st.integers(0, 200), step=st.floats(0.0, 0.2), more=st.binary(max_size=9)
)
def test_tracks(tmp_path, rows, frames, step, more):
    path = tmp_path / "track.csv"
    moving = [f"{step * k},0.1,0.1,0,700,700" for k in range(frames)]
    text = "\n".join([",".join(COLUMNS), *moving, *map(",".join, rows)])
    path.write_bytes(text.encode("utf-8", "replace") + more)
    one_sentence(lambda: read_track(path, (0.3, 0.3)))


@pytest.fixture
def description(motor_fmu) -> str:
    with zipfile.ZipFile(motor_fmu) as archive:
        return archive.read("modelDescription.xml").decode()


WORDS = st.one_of(
    st.sampled_from(("", "0", "-1", "1e999", "nan", "true", "4294967296", "9" * 30, "../a", "1 2")),
    st.sampled_from(("input", "Float64", "parameter", "omega", "omega_des", "fixed", "3.0-beta")),
    st.text(st.characters(exclude_characters='<>&"', exclude_categories=("C",)), max_size=6),
)


@examples(20)
@given(data=st.data())
def test_model_descriptions(motor_fmu, description, tmp_path, monkeypatch, data):
    """With attributes changed, tags renamed, and elements taken out or repeated."""
    monkeypatch.setenv("MINIROBOTS_CACHE", str(tmp_path / "cache"))
    xml = description
    for _ in range(data.draw(st.integers(1, 3))):
        how = data.draw(st.sampled_from(("value", "value", "attribute", "tag", "take", "repeat")))
        pattern = {"value": r'="[^"]*"', "attribute": r' \w+="[^"]*"', "tag": r"<\w+ "}
        found = list(re.finditer(pattern.get(how, r"<\w+ [^>]*/>"), xml))
        match = data.draw(st.sampled_from(found))
        word = data.draw(WORDS)
        by = {"value": f'="{word}"', "attribute": "", "tag": "<Float64 ", "take": ""}
        xml = xml[: match.start()] + by.get(how, 2 * match[0]) + xml[match.end() :]
    path = tmp_path / "mine.fmu"
    with zipfile.ZipFile(motor_fmu) as archive, zipfile.ZipFile(path, "w") as copy:
        for name in archive.namelist():
            if name.startswith("binaries/"):
                copy.writestr(name, archive.read(name))
        copy.writestr("modelDescription.xml", xml)
    one_sentence(lambda: Motor(MotorFmu(path), "m").close())


@examples(20)
@given(st.data())
def test_archives(motor_fmu, tmp_path, monkeypatch, data):
    monkeypatch.setenv("MINIROBOTS_CACHE", str(tmp_path / "cache"))
    content = bytearray(motor_fmu.read_bytes())
    directory = content.index(b"PK\1\2")
    for _ in range(data.draw(st.integers(1, 4))):
        first = data.draw(st.sampled_from((0, directory, directory, len(content) - 22)))
        at = min(first + data.draw(st.integers(0, 200)), len(content) - 1)
        content[at] = data.draw(st.integers(0, 255))
    path = tmp_path / "mine.fmu"
    path.write_bytes(content[: data.draw(st.sampled_from((None, None, None, -1, directory + 50)))])
    one_sentence(lambda: MotorFmu(path))


@pytest.fixture(scope="module")
def recorded(tmp_path_factory) -> bytes:
    """A recording of one signal."""
    path = tmp_path_factory.mktemp("recorded") / "a.rrd"
    with Recording(path, "a", episode_blueprint(1, (0.3, 0.3))) as file:
        times = simulated(np.arange(20.0))
        file.columns("/sim/r1/motors/omega", times, scalars(np.zeros((20, 2))))
    return path.read_bytes()


@pytest.mark.faults
@examples(4)
@given(st.data())
def test_recordings(recorded, tmp_path, data):
    content = bytearray(recorded)
    for at in data.draw(st.lists(st.integers(0, len(content) - 1), min_size=1, max_size=4)):
        content[at] = data.draw(st.integers(0, 255))
    path = tmp_path / "a.rrd"
    path.write_bytes(content[: data.draw(st.integers(0, len(content)))])
    one_sentence(lambda: read_rrd(path))


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3)
    ),
    max_leaves=10,
)  # fmt: skip
TIMINGS = st.dictionaries(
    st.sampled_from(("schema_version", "profile", "seed", "cores", "stages")), JSON
)


@examples(40)
@given(st.one_of(TIMINGS, JSON).map(json.dumps).map(str.encode) | st.binary(max_size=50))
def test_timings(tmp_path, content):
    (tmp_path / "timings.json").write_bytes(content)
    one_sentence(lambda: read_timings(tmp_path))
