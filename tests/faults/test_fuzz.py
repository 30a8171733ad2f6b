"""Whatever stands on a command line or in a file, it is taken or refused in one sentence.

What damage does to policies, curves, moves and captions is tested with their readers
in `tests/agent/test_reading.py`.
"""

import contextlib
import io
import json
import re
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from agent.mdp.config import ProcessConfig
from agent.mdp.interpretations import build_process
from agent.training.learning import build_learning
from agent.training.settings import LearningConfig, read_settings
from analysis.timings import read_timings
from cosim.base.errors import UserError, run_command
from cosim.fmi.motor import Motor, MotorFmu
from cosim.machine.identification.track import read_track, units
from cosim.model.config import CoSimConfig
from cosim.model.params import MotorParams
from cosim.model.preset import FIELDS, find_preset
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_in_world, in_world, read_world
from cosim.model.world import Sensor, World
from cosim.recording.blueprint import episode_blueprint
from cosim.recording.file import Recording, scalars, simulated
from cosim.recording.reader import read_rrd
from cosim.simulation.options import Physics
from minirobots.commands import COMMANDS, class_of
from minirobots.runner import parse
from tests.alone import edited

SMALL = Scenario(
    "small", "", ((4, 0),), (((0, 0),),), 5, 5, robot_diameter_m=0.01, zone=(2, 2, 3, 3)
)


def examples(count: int) -> settings:
    """So many examples, and as many more as the profile has more than Hypothesis' usual 100."""
    profile = settings.get_profile(settings.get_current_profile_name())
    suppressed = [
        HealthCheck.data_too_large,
        HealthCheck.filter_too_much,
        HealthCheck.function_scoped_fixture,
        HealthCheck.too_slow,
    ]
    many = count * profile.max_examples // 100
    return settings(max_examples=many, suppress_health_check=suppressed)


def ended(name: str, arguments: list[str]) -> tuple[int, str]:
    """Status and output of a command that does nothing once its options are taken."""

    def main() -> None:
        kind = class_of(name)
        options: Any = parse(kind, name, arguments, kind.defaults(arguments)).options
        physics = getattr(options, "physics", options)
        if isinstance(physics, Physics):
            physics.config()

    text = io.StringIO()
    with contextlib.redirect_stdout(text), contextlib.redirect_stderr(text):
        try:
            run_command(main)
        except SystemExit as end:
            return int(end.code or 0), text.getvalue()
    return 0, ""


@pytest.fixture(scope="module")
def flags():
    """Every command's options, as its help names them."""
    pattern = re.compile(r"--[a-z][a-z0-9.-]+")
    return {name: sorted({*pattern.findall(ended(name, ["--help"])[1])}) for name in COMMANDS}


ARGUMENTS = st.text(max_size=4) | st.sampled_from(
    ("0", "1", "2", "-1", "nan", "inf", "-inf", "1e-320", "1e300", "1e9", "9" * 30, "0.05",
     "", "x", "1a", "all", "none", "True", "None", "--", "-", "/dev/null", "/proc/none/a.toml",
     "none.toml", "none.npz", "µ", "\udcff", "a\nb", "paper", "moves", "motors", "2e-05")
)  # fmt: skip


@pytest.mark.long
@examples(80)
@given(data=st.data())
def test_any_command_line(flags, data):
    name = data.draw(st.sampled_from(sorted(COMMANDS)))
    names = st.sampled_from(flags[name])
    valued = st.tuples(names, ARGUMENTS)
    option = st.one_of(valued, valued, st.tuples(names), st.tuples(ARGUMENTS))
    arguments = [word for some in data.draw(st.lists(option, max_size=4)) for word in some]
    status, said = ended(name, arguments)
    assert status in {0, 2}, said
    assert "Traceback" not in said
    assert said or status == 0


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
Tables = st.SearchStrategy[dict[str, Any]]


def merged(*tables: Tables) -> Tables:
    """One table of all entries; the last one of a name counts."""
    return st.tuples(*tables).map(lambda parts: {k: v for some in parts for k, v in some.items()})


def table(*known: str | type) -> Tables:
    """A table with some of the names that its reader knows, sometimes another one."""
    names = [n for k in known for n in ((k,) if isinstance(k, str) else k.__annotations__)]
    return st.dictionaries(st.sampled_from((*names, *names, "colour", "")), VALUES, max_size=4)


def below(name: str, inner: Tables) -> Tables:
    """A table below a name, or nothing, or no table."""
    return st.just({}) | (inner | VALUES).map(lambda value: {name: value})


def toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(k)} = {toml(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    if isinstance(value, int) and not isinstance(value, bool):
        return hex(value) if value > 10**300 else str(value)  # no limit of digits
    return json.dumps(value).replace("Infinity", "inf").replace("NaN", "nan")


SENSOR = below("sensor", table(Sensor))
WORLD = merged(table(World), SENSOR)
CELLS = st.lists(st.lists(st.integers(-1, 12), max_size=4), max_size=6) | st.just("top")
CELL = st.lists(st.integers(-1, 12), min_size=2, max_size=2)
ROBOT = merged(
    st.fixed_dictionaries({"target": CELL | VALUES, "starts": CELLS | VALUES}),
    st.just({}) | table("target", "starts"),
)
BOARD = st.sampled_from(
    ({"columns": 12, "rows": 12}, {"columns": 500, "rows": 3, "cell_m": 0.1}, {"cell_m": 0.05})
)
SCENARIO = merged(
    BOARD,
    st.fixed_dictionaries({"robots": st.lists(ROBOT, max_size=4)}),
    st.just({})
    | table("columns", "rows", "cell_m", "zone", "obstacles", "robot_diameter_m", "name"),
    below("world", WORLD),
)
PRESET = merged(
    below("body", table(*FIELDS["body"], "source")),
    below("motor", table(*MotorParams._fields, "source")),
    below("world", merged(table(*FIELDS["world"], "source"), SENSOR)),
    st.just({}) | table("source"),
)
SETTINGS = merged(below("process", table(ProcessConfig)), below("learning", table(LearningConfig)))


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
    world_of: WORLD.map(lambda world: {"world": world}) | below("world", WORLD),
    preset_of: PRESET,
    settings_of: SETTINGS,
}


@pytest.mark.parametrize("use", TABLES)
@examples(40)
@given(data=st.data())
def test_tables(tmp_path, use, data):
    path = tmp_path / "mine.toml"
    content = data.draw(TABLES[use])
    path.write_text("".join(f"{json.dumps(k)} = {toml(v)}\n" for k, v in content.items()), "utf-8")
    one_sentence(lambda: use(path))


CELLS_OF_TRACKS = st.one_of(st.floats(width=32).map(str), st.text(max_size=4), st.just("0"))


@examples(40)
@given(
    rows=st.lists(st.lists(CELLS_OF_TRACKS, max_size=7), max_size=6),
    frames=st.integers(0, 200),
    step=st.floats(0.0, 0.2),
    more=st.binary(max_size=9),
)
def test_tracks(tmp_path, rows, frames, step, more):
    path = tmp_path / "track.csv"
    moving = [f"{step * k},0.1,0.1,0,700,700" for k in range(frames)]
    text = "\n".join([",".join(units(2)), *moving, *map(",".join, rows)])
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
    edited(motor_fmu, path, lambda name, old: xml if name == "modelDescription.xml" else old)
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
