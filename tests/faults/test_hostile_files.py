"""Files of strangers: each is refused in one sentence, in bounded memory and time, unharmed."""

import random
import re
import struct
import zipfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.alone import edited

GROWTH_BYTES = 1.5 * 2**30  # of memory, imports and all refusals together
TRACK = "time,x,y,heading,omega_1,omega_2\n"
ROBOT = '[[robots]]\ntarget = [5, 5]\nstarts = "top"\n'


Maker = Callable[[Path, Path], object]  # of a file at the first path, and sees the FMU
Content = str | bytes | Maker


def described(change: Callable[[str], str | bytes]) -> Maker:
    """The motor FMU with another modelDescription."""

    def edit(name: str, content: bytes) -> str | bytes:
        return change(content.decode()) if name == "modelDescription.xml" else content

    return lambda path, fmu: edited(fmu, path, edit)


def attribute(tag: str, name: str, value: str) -> Maker:
    """The motor FMU with another value of an attribute in the first tag like this."""

    def change(xml: str) -> str:
        changed, count = re.subn(f'(<{tag}[^>]* {name}=)"[^"]*"', f'\\1"{value}"', xml, count=1)
        assert count == 1
        return changed

    return described(change)


def encrypted(path: Path, fmu: Path) -> None:
    """The motor FMU whose first entry says that it needs a password."""
    data = bytearray(fmu.read_bytes())
    for signature, offset in ((b"PK\1\2", 8), (b"PK\3\4", 6)):
        at = data.index(signature) + offset
        data[at : at + 2] = struct.pack("<H", 1)
    path.write_bytes(data)


reference = partial(attribute, '\\w+ (?=[^>]*name="omega_des")', "valueReference")
BROKEN = r"mine\.fmu is broken \(.*export it again"
# Of each kind, hostile files and what the sentence says that refuses them.
FMUS: dict[str, tuple[Content, str]] = {
    "a deep description": (described(lambda _: "<a>" * 10**6), BROKEN),
    "a description that is no XML": (described(lambda _: b"\0\xff" * 9), BROKEN),
    "a wrong token": (
        attribute("fmiModelDescription", "instantiationToken", "{0}"), "cannot be initialised"
    ),
    "another version": (
        attribute("fmiModelDescription", "fmiVersion", "9.0"), "Unsupported FMI version"
    ),
    "an unknown reference": (reference("4000000000"), BROKEN),
    "a reference beyond 32 bits": (reference("99999999999"), "valueReference"),
    "a reference that is not a number": (reference("first"), BROKEN),
    "no description": (
        lambda path, _: zipfile.ZipFile(path, "w").close(), "it has no modelDescription.xml"
    ),
    "an encrypted entry": (encrypted, BROKEN),
    "half": (
        lambda path, fmu: path.write_bytes(fmu.read_bytes()[: fmu.stat().st_size // 2]), BROKEN
    ),
    "nothing": ("", BROKEN),
}  # fmt: skip


def arrays(**content: Any) -> Maker:
    return lambda path, _: np.savez_compressed(path, **content)


class Payload:
    """What a pickle would do: leave a file beside itself."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Callable[[Path], None], tuple[Path]]:
        return Path.touch, (self.path.with_name("evil"),)


def pickled(path: Path, _: Path) -> None:
    payload = np.array([Payload(path)], dtype=object)
    np.savez(path, config=payload, q=payload, visits=payload, random=payload)


def declaring(size: int) -> Maker:
    """An array of a few bytes that says that it is so long, unpacked."""

    def make(path: Path, _: Path) -> None:
        np.savez_compressed(path, config=np.zeros(1000))
        data = bytearray(path.read_bytes())
        at = data.index(b"PK\1\2") + 24
        data[at : at + 4] = struct.pack("<I", size)
        path.write_bytes(data)

    return make


def configured(text: bytes) -> Maker:
    ones = {name: np.ones(1) for name in ("q", "visits", "random")}
    return arrays(config=np.frombuffer(text, dtype=np.uint8), **ones)


POLICIES: dict[str, tuple[Content, str]] = {
    "a pickle": (pickled, "allow_pickle=False"),
    "three gigabytes": (declaring(3 * 2**30), "unpacks to more than 2048 MiB"),
    "another size": (declaring(100), "damaged"),
    "no arrays": (arrays(a=np.ones(1)), "lacks 'config'"),
    "arrays of another kind": (configured(b'{"schema_version": 1}'), "train it again"),
    "a configuration that is no JSON": (configured(b"\xff{"), "damaged"),
    "a configuration too deep": (configured(b"[" * 10**6), "damaged"),
    "text": ("no policy", "damaged"),
    "nothing": ("", "damaged"),
}

LARGE = "columns = 500\nrows = 500\n"
CROWD = "".join(
    f"[[robots]]\ntarget = [{9 * k}, 250]\nstarts = [[0, 0, 3, 3]]\n" for k in range(50)
)
SPLINTERS = ",".join(f"[{x}, {y}]" for x in range(0, 500, 2) for y in range(9, 499, 2))
SCENARIOS: dict[str, tuple[Content, str]] = {
    "a board of a million cells": ("columns = 1000\nrows = 1000\n" + ROBOT, "<= 500"),
    "ten thousand robots": (ROBOT * 10**4, "expected array of length <= 4096"),
    "robots in a heap": (
        LARGE + "robot_diameter_m = 0.01\n" + CROWD, "hardly any combination of starts"
    ),
    "the same cells a thousand times": (
        LARGE + f"obstacles = [{'[0, 0, 499, 499],' * 10**4}]\n" + ROBOT,
        "obstacles lists 2500000000 cells",
    ),
    "starts and targets everywhere": (
        LARGE + "[[robots]]\ntarget = [1, 1]\nstarts = [[0, 0, 499, 499]]\n",
        r"starts\[0\] has cell \(1, 1\)",
    ),
    "a board of splinters": (
        LARGE + f"robot_diameter_m = 0.0001\nobstacles = [{SPLINTERS}]\n" + ROBOT,
        "obstacles make 61250 rectangles",
    ),
    "cells of nothing": ("cell_m = 1e-300\n" + ROBOT, "robot_diameter_m"),
    "infinite cells": ("cell_m = inf\n" + ROBOT, "cell_m"),
    "infinite robots": ("robot_diameter_m = inf\n" + ROBOT, "robot_diameter_m"),
    "tiny cells": ("cell_m = 1e-4\nrobot_diameter_m = 1e-4\n" + ROBOT, "distance_limit_m"),
    "a number of a thousand digits": (f"rows = {'9' * 1000}\n" + ROBOT, "rows"),
    "a number of ten thousand digits": (f"rows = {'9' * 10**4}\n" + ROBOT, "TOML"),
    "arrays without end": ("a = " + "[" * 10**5, "TOML"),
    "65 MiB": ("#" * (65 * 2**20), "larger than 64 MiB"),
    "bytes": (bytes(range(256)), "TOML"),
}  # fmt: skip
WORLDS: dict[str, tuple[Content, str]] = {
    "obstacles beyond all boards": (
        "[world]\nobstacles = [[0, 0, 1000000000, 1000000000]]", "lists 10000000020000000"
    ),
    "obstacles off the board": ("[world]\nobstacles = [[-5, 0]]", "off the 30 x 30"),
    "a thousand patches and one": (
        f"[world]\nmu_patches = [{'{cells=[0,0,1,1],mu=0.1},' * 1001}]",
        "expected array of length <= 1000",
    ),
    "infinite friction": ("[world]\nmu = inf", "mu = inf is invalid"),
}  # fmt: skip
PRESETS: dict[str, tuple[Content, str]] = {
    "an infinite mass": ("[body]\nmass_kg = inf", "mass_kg = inf is invalid"),
    "a mass beyond all floats": (f"[body]\nmass_kg = 0x{'f' * 400}", "mass_kg"),
    "a robot of nothing": ("[body]\ndiameter_m = 1e-320", "diameter_m"),
    "a heavy robot": ("[body]\nmass_kg = 1e300", "mass_kg"),
    "a date": ("[body]\nmass_kg = 2001-01-01", "mass_kg = .* is invalid"),
}
LONG = "[learning]\nepisodes = 1000000000\n"
SETTINGS: dict[str, tuple[Content, str]] = {
    "a table that is none": ("learning = 3", "learning"),
    "endless episodes": (f"[learning]\nepisodes = 1{'0' * 30}", "episodes = 1000"),
    "a curve of a billion points": (LONG + "log_episodes = 1\nlog_window = 1", "log_episodes"),
    "a billion blocks": (LONG + "epsilon_episodes = 7", "epsilon_episodes"),
    "an infinite reward": ("[process]\ngoal_reward = inf", "goal_reward = inf"),
    "an infinite distance": ("[process]\ndistance_limit_m = inf", "limit_m = inf"),
    "a distance beyond all boards": (
        "[process]\ndistance_limit_m = 1e9", r"distance_limit_m = 1e\+09 is more than 500"
    ),
    "endless steps": ("[process]\nstep_limit = 99999999999999999999", "step_limit"),
    "a table of ten gigabytes": (
        '[process]\nfeatures = ["x", "y", "d", "g", "b", "h", "p"]', "466,560,000 states, more than"
    ),
}  # fmt: skip
RECORDINGS: dict[str, tuple[Content, str]] = {
    name: (content, "not a readable Rerun recording")
    for name, content in (
        ("nothing", ""),
        ("text", "no recording"),
        ("a head and nothing else", b"RRF2" + bytes(40)),
        ("a head and noise", b"RRF2" + random.Random(0).randbytes(10**5)),
        ("a FMU", lambda path, fmu: path.write_bytes(fmu.read_bytes())),
    )
}


def track(*times: float) -> str:
    return TRACK + "".join(f"{time},0,0,0,1,1\n" for time in times)


TRACKS: dict[str, tuple[Content, str]] = {
    "nothing": ("", "line 1 has no column time"),
    "times in nanoseconds": (
        track(*(k * 10**8 for k in range(200))), r"span 1.99e\+10 s, more than 3600 s; give them in"
    ),
    "a field of a million letters": (TRACK + "1" * 10**6 + ",0,0,0,0,0\n", "track"),
    "bytes": (bytes(range(256)), "not a track or damaged"),
    "65 MiB": ("0" * (65 * 2**20), "larger than 64 MiB"),
}  # fmt: skip
MOVES: dict[str, tuple[Content, str]] = {
    name: (content, "moves")
    for name, content in (
        ("nothing", ""), ("another value", "[1, 2]"), ("arrays without end", "[" * 10**6),
    )
}  # fmt: skip
# By kind of file: its name, the hostile ones, and the command that meets it.
KINDS = {
    "fmu": ("mine.fmu", FMUS, ("run", "--scenario", "1a", "--motor-fmu")),
    "policy": ("policy.npz", POLICIES, ("evaluate", "--grid")),
    "scenario": ("mine.toml", SCENARIOS, ("train", "--scenario")),
    "world": ("world.toml", WORLDS, ("run", "--world")),
    "preset": ("machine.toml", PRESETS, ("run", "--preset")),
    "settings": ("settings.toml", SETTINGS, ("train", "--config")),
    "recording": ("ep_000.rrd", RECORDINGS, ("inspect",)),
    "track": ("track.csv", TRACKS, ("identify-robot",)),
    "moves": ("moves.json", MOVES, ("train", "--moves")),
}
UNMARKED = 1  # of every kind, the others are faults
CASES = [
    pytest.param(kind, name, marks=() if k < UNMARKED else pytest.mark.faults, id=f"{kind}-{name}")
    for kind, (_, files, _) in KINDS.items()
    for k, name in enumerate(files)
]


@pytest.fixture(scope="module")
def at_rest(bounded) -> int:
    """Memory of the process before any file is read, in bytes."""
    return bounded("inspect", "none.rrd").most_bytes


@pytest.mark.parametrize(("kind", "name"), CASES)
def test_it_is_refused(bounded, at_rest, motor_fmu, tmp_path, kind, name):
    file, files, (command, *arguments) = KINDS[kind]
    path = tmp_path / "in" / file
    path.parent.mkdir()
    content, said = files[name]
    if callable(content):
        content(path, motor_fmu)
    else:
        path.write_bytes(content.encode() if isinstance(content, str) else content)
    before = path.stat().st_mtime_ns
    if command in {"train", "run"}:
        arguments = ["--out", str(tmp_path / "out"), *arguments]
    done = bounded(command, *arguments, path)
    assert done.status == 2, done.stderr
    *progress, error = done.stderr.splitlines()  # the former of a busy machine
    assert error.startswith("error: ")
    assert all(line.endswith(" …") for line in progress)
    assert re.search(said, error), done.stderr
    assert done.stdout == ""
    assert done.most_bytes - at_rest < GROWTH_BYTES
    # nothing was executed, and nothing written but for the cache
    assert list(tmp_path.rglob("*")) == [path.parent, path]
    assert path.stat().st_mtime_ns == before
    assert not list(Path("/tmp").glob("evil*"))
