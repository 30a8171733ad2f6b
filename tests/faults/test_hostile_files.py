"""Files of strangers: each is refused in one sentence, in bounded memory and time, unharmed."""

import json
import random
import re
import struct
import zipfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

GROWTH_BYTES = 1.5 * 2**30  # of memory, imports and all refusals together
TRACK = "time,x,y,heading,omega_1,omega_2\n"
ROBOT = '[[robots]]\ntarget = [5, 5]\nstarts = "top"\n'


class Hostile(NamedTuple):
    """A file that nobody should make.

    Attributes:
        make: writes it at a path; it may look at the built-in FMU.
        said: in the sentence that refuses it, a pattern.
    """

    make: Callable[[Path, Path], object]
    said: str


def text(content: str | bytes) -> Callable[[Path, Path], object]:
    data = content if isinstance(content, bytes) else content.encode()
    return lambda path, _: path.write_bytes(data)


def described(
    change: Callable[[str], str | bytes], *, binary: bytes | None = None
) -> Callable[[Path, Path], object]:
    """The motor FMU with another modelDescription, and perhaps another binary."""

    def make(path: Path, fmu: Path) -> None:
        with (
            zipfile.ZipFile(fmu) as archive,
            zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as copy,
        ):
            for name in archive.namelist():
                content: bytes | str = archive.read(name)
                if name == "modelDescription.xml":
                    content = change(archive.read(name).decode())
                elif binary is not None and name.startswith("binaries/"):
                    content = binary
                copy.writestr(name, content)

    return make


def attribute(tag: str, name: str, value: str) -> Callable[[Path, Path], object]:
    """The motor FMU with another value of an attribute in the first tag like this."""

    def change(xml: str) -> str:
        found = re.search(f"<{tag}[^>]*>", xml)
        assert found
        changed, count = re.subn(f' {name}="[^"]*"', f' {name}="{value}"', found[0])
        assert count == 1
        return xml.replace(found[0], changed, 1)

    return described(change)


def cut(share: float) -> Callable[[Path, Path], object]:
    def make(path: Path, fmu: Path) -> None:
        content = fmu.read_bytes()
        path.write_bytes(content[: int(share * len(content))])

    return make


def encrypted(path: Path, fmu: Path) -> None:
    """The motor FMU whose first entry says that it needs a password."""
    data = bytearray(fmu.read_bytes())
    for signature, offset in ((b"PK\1\2", 8), (b"PK\3\4", 6)):
        at = data.index(signature) + offset
        data[at : at + 2] = struct.pack("<H", 1)
    path.write_bytes(data)


reference = partial(attribute, '\\w+ (?=[^>]*name="omega_des")', "valueReference")
BROKEN = r"mine\.fmu is broken \(.*build one with"
FMUS = {
    "a deep description": Hostile(described(lambda _: "<a>" * 10**6), BROKEN),
    "a description that is no XML": Hostile(described(lambda _: b"\0\xff" * 9), BROKEN),
    "an unknown encoding": Hostile(
        described(lambda _: '<?xml version="1.0" encoding="EBCDIC-CP-US"?><a/>'), BROKEN
    ),
    "a foreign binary": Hostile(
        described(lambda xml: xml, binary=b"MZ" + bytes(999)), "cannot be initialised"
    ),
    "a wrong token": Hostile(
        attribute("fmiModelDescription", "instantiationToken", "{0}"), "cannot be initialised"
    ),
    "another version": Hostile(
        attribute("fmiModelDescription", "fmiVersion", "9.0"), "Unsupported FMI version"
    ),
    "an unknown reference": Hostile(reference("4000000000"), BROKEN),
    "a negative reference": Hostile(reference("-1"), "valueReference"),
    "a reference beyond 32 bits": Hostile(reference("99999999999"), "valueReference"),
    "a reference that is not a number": Hostile(reference("first"), BROKEN),
    "no description": Hostile(
        lambda path, _: zipfile.ZipFile(path, "w").close(), "it has no modelDescription.xml"
    ),
    "an encrypted entry": Hostile(encrypted, BROKEN),
    **{f"cut at {share}": Hostile(cut(share), BROKEN) for share in (0.01, 0.5, 0.99)},
    "nothing": Hostile(text(""), BROKEN),
}  # fmt: skip


def arrays(**content: Any) -> Callable[[Path, Path], object]:
    return lambda path, _: np.savez_compressed(path, **content)


def configured(**more: Any) -> Callable[[Path, Path], object]:
    """A policy file with the configuration of nobody."""
    config = np.frombuffer(json.dumps({"schema_version": 1}).encode(), dtype=np.uint8)
    return arrays(config=config, **more)


class Payload:
    """What a pickle would do: leave a file beside itself."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Callable[[Path], None], tuple[Path]]:
        return Path.touch, (self.path.with_name("evil"),)


def pickled(path: Path, _: Path) -> None:
    payload = np.array([Payload(path)], dtype=object)
    np.savez(path, config=payload, q=payload, visits=payload, random=payload)


def declaring(size: int) -> Callable[[Path, Path], object]:
    """An array of a few bytes that says that it is so long, unpacked."""

    def make(path: Path, _: Path) -> None:
        np.savez_compressed(path, config=np.zeros(1000))
        data = bytearray(path.read_bytes())
        at = data.index(b"PK\1\2") + 24
        data[at : at + 4] = struct.pack("<I", size)
        path.write_bytes(data)

    return make


ONE = np.zeros(1)
POLICIES = {
    "a pickle": Hostile(pickled, "holds Python objects"),
    "three gigabytes": Hostile(declaring(3 * 2**30), "unpacks to more than 2048 MiB"),
    "another size": Hostile(declaring(100), "damaged"),
    "no arrays": Hostile(arrays(a=ONE), "lacks 'config'"),
    "arrays of another kind": Hostile(configured(q=ONE, visits=ONE, random=ONE), "train it again"),
    "a configuration that is no JSON": Hostile(
        arrays(config=np.frombuffer(b"\xff{", dtype=np.uint8)), "damaged"
    ),
    "a configuration too deep": Hostile(
        arrays(config=np.frombuffer(b"[" * 10**6, dtype=np.uint8)), "damaged"
    ),
    "text": Hostile(text("no policy"), "damaged"),
    "nothing": Hostile(text(""), "damaged"),
}  # fmt: skip

DEEP = ".".join("a" * 20_000)
QUOTED = '"a"'
MANY = '[[robots]]\ntarget = [0, 0]\nstarts = "top"\n' * 10**4
CROWD = "columns = 500\nrows = 500\nrobot_diameter_m = 0.01\n" + "".join(
    f'[[robots]]\ntarget = [{9 * k}, 250]\nstarts = [[0, 0, 3, 3]]\n' for k in range(50)
)  # fmt: skip
FULL = "columns = 500\nrows = 500\n[[robots]]\ntarget = [1, 1]\nstarts = [[0, 0, 499, 499]]\n"
SCENARIOS = {
    "a board of a million cells": Hostile(text("columns = 1000\nrows = 1000\n" + ROBOT), "<= 500"),
    "ten thousand robots": Hostile(text(MANY), r"robots: expected 'array' of length <= 4096"),
    "robots in a heap": Hostile(text(CROWD), "hardly any combination of starts"),
    "the same cells a thousand times": Hostile(
        text("columns = 500\nrows = 500\n"
             + f"obstacles = [{'[0, 0, 499, 499],' * 10**4}]\n" + ROBOT),
        "obstacles lists 2500000000 cells",
    ),
    "starts and targets everywhere": Hostile(text(FULL), r"starts\[0\] has cell \(1, 1\)"),
    "a board of splinters": Hostile(
        text("columns = 500\nrows = 500\nrobot_diameter_m = 0.0001\nobstacles = ["
             + ",".join(f"[{x}, {y}]" for x in range(0, 500, 2) for y in range(9, 499, 2))
             + "]\n" + ROBOT),
        "obstacles make 61250 rectangles",
    ),
    "cells of nothing": Hostile(text("cell_m = 1e-300\n" + ROBOT), "robot_diameter_m"),
    "infinite cells": Hostile(text("cell_m = inf\n" + ROBOT), "cell_m"),
    "cells of no number": Hostile(text("cell_m = nan\n" + ROBOT), "cell_m"),
    "infinite robots": Hostile(text("robot_diameter_m = inf\n" + ROBOT), "robot_diameter_m"),
    "tiny cells": Hostile(
        text("cell_m = 1e-4\nrobot_diameter_m = 1e-4\n" + ROBOT), "distance_limit_m"
    ),
    "a number of a thousand digits": Hostile(text(f"rows = {'9' * 1000}\n" + ROBOT), "rows"),
    "a number of ten thousand digits": Hostile(text(f"rows = {'9' * 10**4}\n" + ROBOT), "TOML"),
    "an unknown key": Hostile(text("colour = 1\n" + ROBOT), "colour is unknown"),
    "another type": Hostile(text('rows = "many"\n' + ROBOT), "rows = .many. is invalid"),
    "arrays without end": Hostile(text("a = " + "[" * 10**5), "TOML"),
    "a key of twenty thousand parts": Hostile(
        text(f"rows = 9\n{DEEP} = 1\n" + ROBOT), "line 2 has a key of more than 32 parts"
    ),
    "a table of twenty thousand parts": Hostile(text(f"[{DEEP}]"), "line 1 has a key of more"),
    "a quoted key of twenty thousand parts": Hostile(
        text(f"a = {{{DEEP.replace('a', QUOTED)} = 1}}"), "line 1 has a key of more"
    ),
    "65 MiB": Hostile(text("#" * (65 * 2**20)), "larger than 64 MiB"),
    "bytes": Hostile(text(bytes(range(256))), "TOML"),
}  # fmt: skip
WORLDS = {
    "obstacles beyond all boards": Hostile(
        text("[world]\nobstacles = [[0, 0, 1000000000, 1000000000]]"), "lists 10000000020000000"
    ),
    "obstacles off the board": Hostile(text("[world]\nobstacles = [[-5, 0]]"), "off the 30 x 30"),
    "a thousand patches and one": Hostile(
        text(f"[world]\nmu_patches = [{'{cells=[0,0,1,1],mu=0.1},' * 1001}]"),
        "expected array of length <= 1000",
    ),
    "infinite friction": Hostile(text("[world]\nmu = inf"), "mu = inf is invalid"),
    "a load of no number": Hostile(text("[world]\npayload_g = nan"), "payload_g"),
    "an unknown key": Hostile(text("[world]\ngravity = 1"), "world.gravity is unknown"),
    "another type": Hostile(text("[world]\nmu = [1]"), r"world\.mu"),
}
PRESETS = {
    "an unknown key": Hostile(text("[robot]\ncolour = 1"), "robot.colour is unknown"),
    "another type": Hostile(text('[motor]\nJ = "much"'), "J = 'much' is invalid"),
    "an infinite mass": Hostile(text("[robot]\nmass_kg = inf"), "mass_kg = inf is invalid"),
    "a mass beyond all floats": Hostile(
        text(f"[robot]\nmass_kg = 0x{'f' * 400}"), "mass_kg"
    ),
    "a robot of nothing": Hostile(text("[robot]\ndiameter_m = 1e-320"), "diameter_m"),
    "a heavy robot": Hostile(text("[robot]\nmass_kg = 1e300"), "mass_kg"),
    "a date": Hostile(text("[robot]\nmass_kg = 2001-01-01"), "J = 'much' is invalid"),
}  # fmt: skip
SETTINGS = {
    "an unknown key": Hostile(text("[learning]\nspeed = 1"), "unknown field learning.speed"),
    "another type": Hostile(text("[learning]\nepisodes = 'all'"), r"learning\.episodes"),
    "a table that is none": Hostile(text("learning = 3"), "learning"),
    "endless episodes": Hostile(text(f"[learning]\nepisodes = 1{'0' * 30}"), "episodes = 1000"),
    "a curve of a billion points": Hostile(
        text("[learning]\nepisodes = 1000000000\nlog_episodes = 1\nlog_window = 1"), "log_episodes"
    ),
    "a billion blocks": Hostile(
        text("[learning]\nepisodes = 1000000000\nepsilon_episodes = 7"), "epsilon_episodes"
    ),
    "an infinite reward": Hostile(text("[process]\ngoal_reward = inf"), "goal_reward = inf"),
    "an infinite distance": Hostile(text("[process]\ndistance_limit_m = inf"), "limit_m = inf"),
    "a distance beyond all boards": Hostile(
        text("[process]\ndistance_limit_m = 1e9"), r"distance_limit_m = 1e\+09 is more than 500"
    ),
    "endless steps": Hostile(text("[process]\nstep_limit = 99999999999999999999"), "step_limit"),
    "a table of ten gigabytes": Hostile(
        text('[process]\nfeatures = ["x", "y", "d", "g", "b", "h", "p"]'),
        "466,560,000 states, more than",
    ),
}
RECORDINGS = {
    "nothing": Hostile(text(""), "not a readable Rerun recording"),
    "text": Hostile(text("no recording"), "not a readable Rerun recording"),
    "a head and nothing else": Hostile(text(b"RRF2" + bytes(40)), "not a readable Rerun recording"),
    "a head and noise": Hostile(
        text(b"RRF2" + random.Random(0).randbytes(10**5)), "not a readable Rerun recording"
    ),
    "a FMU": Hostile(
        lambda path, fmu: path.write_bytes(fmu.read_bytes()), "not a readable Rerun recording"
    ),
}
LINE = "{},0,0,0,1,1\n"
TRACKS = {
    "nothing": Hostile(text(""), "line 1 has no column time"),
    "another head": Hostile(text("a,b\n1,2\n"), "line 1 has no column time"),
    "a head alone": Hostile(text(TRACK), "after 0 frames"),
    "words": Hostile(text(TRACK + "a,b,c,d,e,f\n"), "line 2: time: 'a' is not a number"),
    "no numbers": Hostile(text(TRACK + "nan,0,0,0,0,0\n"), "line 2: time: 'nan' is not a number"),
    "a short line": Hostile(text(TRACK + "1,2\n"), "line 2: y: the number is missing"),
    "time backwards": Hostile(
        text(TRACK + "".join(LINE.format(k / 10 if k != 50 else 0) for k in range(200))),
        "line 52: its time is not after",
    ),
    "times in nanoseconds": Hostile(
        text(TRACK + "".join(LINE.format(k * 10**8) for k in range(200))),
        "span 1.99e+10 s, more than 3600 s; give them in seconds".replace("+", r"\+"),
    ),
    "a field of a million letters": Hostile(text(TRACK + "1" * 10**6 + ",0,0,0,0,0\n"), "track"),
    "bytes": Hostile(text(bytes(range(256))), "not a track or damaged"),
    "65 MiB": Hostile(text("0" * (65 * 2**20)), "larger than 64 MiB"),
}
MOVES = {
    "nothing": Hostile(text(""), "moves"),
    "another value": Hostile(text("[1, 2]"), "moves"),
    "arrays without end": Hostile(text("[" * 10**6), "moves"),
}
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
    files[name].make(path, motor_fmu)
    before = path.stat().st_mtime_ns
    if command in {"train", "run"}:
        arguments = ["--out", str(tmp_path / "out"), *arguments]
    done = bounded(command, *arguments, path)
    assert done.status == 2, done.stderr
    assert done.stderr.startswith("error: ")
    assert done.stderr.count("\n") == 1
    assert re.search(files[name].said, done.stderr), done.stderr
    assert done.stdout == ""
    assert done.most_bytes - at_rest < GROWTH_BYTES
    # nothing was executed, and nothing written but for the cache
    assert list(tmp_path.rglob("*")) == [path.parent, path]
    assert path.stat().st_mtime_ns == before
    assert not list(Path("/tmp").glob("evil*"))
