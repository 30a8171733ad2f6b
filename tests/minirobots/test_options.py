"""Every option of every command reaches something: another value, another result or a refusal.

A command runs twice as `BASES` has it, and what differs between the two (times, for example) does
not count. Then it runs with another value of one option. Lines, numbers, arrays, signals or
pictures that do not repeat the option itself must differ, or the command refuses the value.
"""

import re
import shlex
import shutil
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple, get_args, get_origin, get_type_hints

import pytest

from cosim.base.errors import UserError
from minirobots.commands import COMMANDS, class_of
from tests.fingerprint import fingerprint

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"


LONG = 300  # characters of a line that says more than an option


class Base(NamedTuple):
    """A command line, other values of its options, and the ending of what it writes."""

    arguments: str
    options: dict[str, str]  # value by name, none of a flag; with what the value needs besides
    out: str | None = ""  # ending of the file or folder --out; None for none


PROCESS = {
    "process.goal-reward": "200",
    "process.step-cost": "2",
    "process.diagonal-cost": "2.5",
    "process.reward-per": "distance",
    "process.approach-coefficient": "5",
    "process.distance-limit-m": "0.05",
    "process.features": "x y d",
    "process.target-obstacle": "disk",
    "process.collision": "swept",
    "process.partner-of-failed": "none",
    "process.slip-probability": "0.1",
    "process.clearance-m": "0.02",
    "process.step-limit": "20",
}
LEARNING = {
    "learning.episodes": "4000",
    "learning.eta": "0.02",
    "learning.eta-end": "0.001",
    "learning.gamma": "0.9",
    "learning.epsilon": "0.5",
    "learning.epsilon-decay": "0.5",
    "learning.epsilon-episodes": "100",
    "learning.exploration": "0.3",
    "learning.schedule": "linear",
    "learning.log-episodes": "300",
    "learning.log-window": "50",
    "learning.greedy-points": "3",
}
MACHINE = {"preset": "icra2006", "motor-parameter": "J=2e-8"}
PHYSICS = MACHINE | {
    "mu": "0.25",
    "noise": "0.2",
    "dt": "2e-5",
    "communication-step": "2e-5",
    "reaction": "",
}
DRIVING = PHYSICS | {
    "rl-step": "1",
    "through": "",
    "world": str(EXAMPLES / "slippery.toml"),
    "speed": "3",
    "on-collision": "continue",
    "shield": "",
    "open-loop": "motors",
    "time-limit": "6",
}
WORLDS = {
    "worlds.mu": "0.2 0.3",
    "worlds.patches": "2",
    "worlds.patch-cells": "2 4",
    "worlds.motor-spread": "0.2 0.3",
    "worlds.restitution": "0.3 0.4",
    "worlds.floor-tilt-deg": "0.5 1",
    "worlds.payload-g": "6 9",
    "worlds.payload-offset-mm": "2 4",
    "worlds.rate-hz": "10 12",
    "worlds.delay-ms": "90 99",
    "worlds.position-noise-mm": "2 3",
    "worlds.heading-noise-deg": "3 4",
    "worlds.dropout": "0.3 0.4",
}
BASES = {
    "bound": [Base("--scenario 4", {"scenario": "2"} | PROCESS, None)],
    "train": [
        Base(
            "--scenario 4 --learning.episodes 3000 --learning.log-episodes 500 --jobs 1",
            {"scenario": "2", "method": "double_q", "runs": "2", "seed": "3"}
            | {"config": "settings.toml", "world": "wall.toml"}
            | {"preset": "kilobot", "motor-parameter": "J=2e-8"}
            | PROCESS
            | LEARNING,
        )
    ],
    "experiments": [
        Base(
            "fig08 --runs 1 --episodes 3000",
            {"runs": "2", "seed": "2", "episodes": "4000", "greedy-points": "5"},
        )
    ],
    "platform": [
        Base("", {"omega": "500", "mu": "0.3", "cycles": "4", "preset": "icra2006"}, ".npz")
    ],
    "design": [Base("--speed 4", {"speed": "3", "preset": "icra2006", "mu": "0.3"}, None)],
    "motor-loop": [Base("", {"omega-des": "600", "motor-parameter": "J=5e-9"}, ".png")],
    "motor-test": [
        Base(
            "--duration 0.3",
            {"duration": "0.4", "omega-des": "500", "open-loop-v": "1", "d": "1e-5"}
            | {"motor-parameter": "J=5e-9"},
            ".rrd",
        )
    ],
    "export": [
        Base(
            "a.rrd --to csv", {"to": "parquet", "signals": "r1/motors/omega", "rate": "20"}, ".csv"
        )
    ],
    "video": [Base("a.rrd", {"speed": "20"}, ".gif")],
    "inspect": [Base("a.rrd", {"parameters": ""}, None)],
    "study": [
        Base("study.toml", {"trainings": "2", "quantity": "energy_j", "budget-minutes": "0"})
    ],
    "evaluate": [
        Base(
            "shortest --scenario 4 --time-limit 8 --starts 2 --claim 'collision < 0.9'",
            {"starts": "3", "seed": "3", "confidence": "0.6", "claim": "'success > 0.99'"}
            | {"trainings": "2", "recordings": "1", "budget-minutes": "0", "scenario": "2"}
            | {"policy": "fastest"}
            | DRIVING,
        ),
    ],
    "run": [
        Base(
            "--scenario 4 --train-episodes 3000 --time-limit 8",
            {"scenario": "2", "method": "double_q", "train-episodes": "4000", "train-seed": "2"}
            | {"episodes": "2", "seed": "3", "record": "summary", "no-record": "", "signals": "1"}
            | {"show-config": ""}
            | DRIVING,
        ),
        Base("--scenario 4 --show-config", {"record": "full"} | DRIVING, None),
    ],
    "web": [
        Base(
            "--scenario 4 --method shortest",
            {"scenario": "2", "method": "paper", "worlds": "rough", "seed": "3"} | DRIVING,
            ".html",
        )
    ],
    "calibrate": [Base("", PHYSICS)],
    "moves": [
        Base(
            "--moves 1",
            {"moves": "17", "cell": "0.012", "seed": "3", "worlds": "", "rl-step": "1"}
            | {"through": ""}
            | PHYSICS,
            ".json",
        ),
        Base("--moves 1 --worlds", WORLDS, ".json"),
    ],
}
# Commands that take their time, but for what they show with --show-config
TAKE_LONG = dict.fromkeys(
    ["bound", "design", "experiments", "motor-test", "platform", "study", "train", "video"],
    pytest.mark.long,
)
TAKE_LONG |= dict.fromkeys(
    ["calibrate", "evaluate", "motor-loop", "moves", "run", "web"], pytest.mark.slow
)
# Of any command: where results are computed or written, and shown meanwhile; they do not change.
ELSEWHERE = ("out", "jobs", "backend", "address", "live", "spawn", "viewer", "driver", "again")
# Options, or whole commands, whose effect other tests hold.
TESTED = {
    "motor-fmu": "tests/cosim/fmi",
    "evaluate grid": "tests/agent/study",
    "train log": "tests/agent/training/test_recording.py",
    "train moves": "tests/agent/moves",
    "run policy": "tests/minirobots/test_doors.py",
    "web policy": "tests/agent/web/test_page.py",
    "compare": "tests/minirobots/test_compare.py",
    "draw": "tests/cosim/model/test_machines.py",
    "figures": "tests/analysis",
    "fmu": "tests/fmus",
    "identify-robot": "tests/cosim/machine/identification",
    "methods": "tests/agent/test_method.py",
    "replay": "tests/minirobots",
    "reproduce": "tests/analysis/test_reproduce.py",
    "screenshot": "tests/analysis/test_screenshot.py",
}
CASES = [
    pytest.param(
        name,
        k,
        id=f"{name}-{k}",
        marks=() if "--show-config" in base.arguments else TAKE_LONG.get(name, ()),
    )
    for name, bases in BASES.items()
    for k, base in enumerate(bases)
]


@pytest.fixture(scope="module")
def folder(command, tmp_path_factory) -> Path:
    """Files that command lines name."""
    folder = tmp_path_factory.mktemp("files")
    (folder / "settings.toml").write_text("[learning]\neta = 0.05\nepisodes = 3000\n")
    (folder / "wall.toml").write_text("[world]\nobstacles = [[10, 10, 12, 12]]\n")
    study = 'policies = ["paper", "shortest"]\nscenario = "1a"\nepisodes = 2\ntime_limit = 4\n'
    (folder / "study.toml").write_text(study)
    train = "--scenario", "4", "--learning.episodes", 3000, "--out", folder / "trained"
    drive = "--scenario", "2", "--method", "shortest", "--time-limit", 4, "--out", folder / "driven"
    for name, arguments in (("train", train), ("run", drive)):
        assert command(name, *arguments).returncode == 0
    shutil.copy(folder / "trained" / "run_000" / "policy.npz", folder)
    shutil.copy(folder / "driven" / "episodes" / "ep_000.rrd", folder / "a.rrd")
    return folder


@pytest.fixture
def outcome(command, folder, tmp_path_factory, monkeypatch) -> Callable[..., tuple[int, dict]]:
    """Run a command; its status, and all that it printed and wrote, by what it is of."""

    def run(name: str, base: Base, *more: str) -> tuple[int, dict[str, Any]]:
        where = tmp_path_factory.mktemp("results")
        monkeypatch.chdir(folder)
        out = [] if base.out is None else ["--out", where / f"out{base.out}"]
        done = command(name, *shlex.split(base.arguments), *out, "--json", *more)
        text = done.stdout.replace(str(where), "OUT")
        return done.returncode, fingerprint(where, text) | {"said": done.stderr}

    return run


@pytest.mark.parametrize(("name", "number"), CASES)
def test_another_value_gives_another_result_or_is_refused(name, number, outcome):
    base = BASES[name][number]
    (status, usual), (_, again) = outcome(name, base), outcome(name, base)
    assert status in (0, 1), usual["said"]
    stable = {key: value for key, value in usual.items() if again.get(key) == value}
    assert stable
    without: list[str] = []
    for option, text in base.options.items():
        values = shlex.split(text)
        status, found = outcome(name, base, f"--{option}", *values)
        if status == 2:
            assert "error: " in found["said"] or "\u2500" in found["said"], found["said"]
            continue
        assert status in (0, 1), (option, found["said"])
        changed = {key for key in stable if found.get(key) != stable[key]} | found.keys() - usual
        if all(_repeats(key, found.get(key), option, values) for key in changed - {"said"}):
            without.append(option)
    assert not without, f"no effect of {', '.join(without)}"


def test_a_calibration_is_measured_again_if_asked(command, monkeypatch, tmp_path):
    def refuse(*_: Any) -> None:
        raise UserError("it is measured")

    monkeypatch.setattr("cosim.calibration.measuring.measure", refuse)
    assert command("calibrate", "--out", tmp_path).returncode == 0  # found in the cache
    again = command("calibrate", "--out", tmp_path, "--again")
    assert (again.returncode, "it is measured" in again.stderr) == (2, True)


def test_long_work_is_given_its_seed_its_cells_and_its_place(command, monkeypatch, tmp_path):
    """Of commands that take too long for other values of every option."""
    given: dict[str, Any] = {}

    def refuse(*_: Any, **named: Any) -> None:
        given.update(named)
        raise UserError("begun")

    monkeypatch.setattr("agent.moves.observe.observe_moves", refuse)
    monkeypatch.setattr("agent.study.user.study", refuse)
    monkeypatch.setattr("cosim.calibration.primitives.measured", refuse)
    (tmp_path / "study.toml").write_text('policies = ["shortest"]\nscenario = "1a"\n')
    where = "--jobs", 3, "--backend", "loky", "--out", tmp_path
    for line in (
        ("moves", "--seed", 7, "--cell", 0.02, "--moves", 5, "--out", tmp_path / "m.json"),
        ("study", tmp_path / "study.toml", *where),
        ("calibrate", "--preset", "kilobot", "--again", "--out", tmp_path),
    ):
        assert "begun" in command(*line).stderr
    expected = {"seed": 7, "cell_m": 0.02, "moves_per_kind": 5, "jobs": 3, "backend": "loky"}
    assert given == given | expected | {"again": True}


def test_every_option_is_tried():
    missing = []
    for name in COMMANDS:
        if name in TESTED:
            continue
        tried = {option for base in BASES[name] for option in base.options}
        for option in _options(class_of(name)):
            known = {f"{name} {option}", option} & TESTED.keys() or option in ELSEWHERE
            if not known and not any(option == t or t.endswith(f".{option}") for t in tried):
                missing.append(f"{name} --{option}")
    assert not missing


_NAMES = {"motor_parameters": "motor-parameter", "ranges": "worlds"}  # of fields, as options


def _options(kind: Any) -> Iterator[str]:
    """Names of a command's options, without those of positional arguments."""
    hints = get_type_hints(kind, include_extras=True)
    for field in fields(kind):
        hint = hints[field.name]
        own = get_args(hint)[0] if get_origin(hint) is Annotated else hint
        marks = [str(mark) for mark in getattr(hint, "__metadata__", ())]
        if is_dataclass(own):
            yield from _options(own)
        elif not any("Positional" in mark for mark in marks):
            yield _NAMES.get(field.name, field.name.replace("_", "-"))


def _repeats(key: str, content: Any, option: str, values: list[str]) -> bool:
    """Return whether a part of a result is the option itself: named so, or its value."""
    name = "[ _-]".join(re.split(r"[_-]", option.rpartition(".")[2]))
    text = f"{key.rpartition(' ')[2]} {content}"
    named = len(text) < LONG and re.search(rf"\b{name}\b", text, re.I) is not None
    return named or str(content) in values
