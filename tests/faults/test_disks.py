"""Places where nothing can be written: one sentence, and no file that is not whole."""

import ctypes
import os
import re
import resource
import subprocess
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import pytest

from cosim.base.errors import FileError
from cosim.base.storage import CACHE
from cosim.fmi.motor import MotorFmu
from tests.faults.killing import CACHED, REMADE, Case, Workplace, without_progress

DAC_OVERRIDE, DAC_READ_SEARCH, PR_CAPBSET_DROP = 1, 2, 24
FULL_BYTES = 1000
DISK_BYTES = 1 << 20  # of a disk
TRAIN = ("-m", "minirobots", "train", "--jobs", "1", "--scenario", "1a",
         "--learning.episodes", "2000", "--learning.epsilon-episodes", "10")  # fmt: skip
COMMANDS = {
    "excitation": ("-m", "minirobots", "identify-robot", "--excite", "OUT/a.csv"),
    "training": (*TRAIN, "--out", "OUT/a"),
    "FMU": ("-m", "minirobots", "fmu", "motor", "--out", "OUT/a"),
}
# What is done before a command starts in its process.
Prepare = Callable[[], None] | None


def powerless() -> None:
    """Have permissions hold for root, too: what is executed next cannot override them."""
    for capability in (DAC_OVERRIDE, DAC_READ_SEARCH):
        ctypes.CDLL(None).prctl(PR_CAPBSET_DROP, capability, 0, 0, 0)  # others have it not


def limited(size: int = FULL_BYTES) -> None:
    """Let no file grow beyond what a small one has: writes fail as on a full disk."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))


def mounted(folder: Path, size: str) -> bool:
    """Make a folder a disk of its own, where this user may mount anything."""
    mount = ("mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder))
    return not os.geteuid() and not subprocess.run(mount, check=False).returncode


@pytest.fixture
def out(tmp_path):
    """A folder that may become a disk of its own."""
    path = tmp_path / "out"
    path.mkdir()
    yield path
    if path.is_mount():
        subprocess.run(("umount", str(path)), check=True)


def forbidden(out: Path) -> tuple[Prepare, str]:
    out.chmod(0o555)
    return powerless, "permission denied; choose another place"


def file(out: Path) -> tuple[Prepare, str]:
    out.rmdir()
    out.touch()
    return powerless, "choose another place"


def read_only(out: Path) -> tuple[Prepare, str]:
    if not mounted(out, str(DISK_BYTES)):
        return forbidden(out)
    subprocess.run(("mount", "-o", "remount,ro", str(out)), check=True)
    return None, "the file system is read-only"


def full(out: Path, free_bytes: int = 0) -> tuple[Prepare, str]:
    if not mounted(out, str(DISK_BYTES)):
        return limited, "free some|ulimit -f"
    (out / "other").write_bytes(bytes(DISK_BYTES - free_bytes))
    return None, "free some space"


PLACES: dict[str, Callable[[Path], tuple[Prepare, str]]] = {
    "without permission": forbidden,
    "a file": file,
    "a name that is too long": lambda _: (None, "its name is longer than the file system allows"),
    "read-only": read_only,
    "full": full,
    "limited": lambda _: (limited, "ulimit -f"),
}
QUICK = {"without permission", "a name that is too long", "full"}  # for the first command
CASES = [
    pytest.param(
        place, name, marks=() if {place, name} <= {*QUICK, "excitation"} else pytest.mark.faults
    )
    for place in PLACES
    for name in COMMANDS
    if place != "limited" or name == "excitation"
]


@pytest.mark.long
@pytest.mark.parametrize(("place", "name"), CASES)
def test_a_place_where_nothing_can_be_written(tmp_path, out, place, name):
    def contents() -> dict[Path, bytes]:
        files = [path for path in (out, *out.rglob("*")) if path.is_file()]
        return {path: path.read_bytes() for path in files}

    prepare, said = PLACES[place](out)
    before, work = contents(), Workplace(tmp_path / "work", Case(COMMANDS[name], ()))
    work.out = out.with_name("a" * 300) if "long" in place else out
    status, errors = work.end(prepare)
    errors = without_progress(errors)
    assert status == 2, errors
    assert errors.startswith("error: ")
    assert errors.count("\n") == 1
    assert str(work.out) in errors
    assert re.search(said, errors)
    assert contents() == before
    assert [p for p in tmp_path.rglob("*") if ".tmp-" in p.name] == []


def test_a_cache_that_no_fmu_can_be_loaded_from_is_named(out, array_fmu, monkeypatch):
    if not mounted(out, "20m,noexec"):
        monkeypatch.setattr(os, "statvfs", lambda _: SimpleNamespace(f_flag=os.ST_NOEXEC))
    monkeypatch.setenv(CACHE, str(out))
    with pytest.raises(FileError, match=rf"{out}/.* noexec, .* set {CACHE} to a folder of another"):
        MotorFmu(array_fmu)


@pytest.mark.faults
@pytest.mark.parametrize("name", COMMANDS)
def test_missing_parents_are_made(tmp_path, name):
    work = Workplace(tmp_path / "work", Case(COMMANDS[name], ()))
    work.out = tmp_path / "deep" / "out"
    work.run()
    assert list(work.out.iterdir())


@pytest.mark.faults
@pytest.mark.parametrize("megabytes", [1, 3, 8, 20])
def test_a_cache_on_a_disk_that_fills(tmp_path, megabytes):
    """Runs end in a one-line error or well, whatever the disk has; with room the next goes well.

    Where this user may not mount anything, a limit of file sizes stands in for the disk.
    """
    arguments = ("--method", "paper", "--train-episodes", "20000", "--time-limit", "4")
    case = Case(("-m", "minirobots", "run", "--scenario", "1a", "--out", "OUT", *arguments), CACHED)
    place, other = Workplace(tmp_path / "full", case), Workplace(tmp_path / "other", case)
    disk = mounted(place.cache, f"{megabytes}m")
    try:
        for _ in range(5):
            status, errors = place.end(None if disk else partial(limited, megabytes * 10_000))
            assert status in {0, 2}, errors
            if status:
                assert re.search("free some|ulimit -f", errors), errors
                assert without_progress(errors).count("\n") == 1, errors
            assert not REMADE.search(errors)
        if disk:
            again = ("mount", "-o", "remount,size=500m", str(place.cache))
            subprocess.run(again, check=True)
        other.environment["MINIROBOTS_CACHE"] = str(place.cache)
        for each in (place, other):
            _, errors = each.run()
            assert not REMADE.search(errors)
        assert other.files() == place.files()
        assert not [path for path in place.cache.rglob("*.tmp-*") if path.is_file()]
    finally:
        if disk:
            subprocess.run(("umount", str(place.cache)), check=True)


@pytest.mark.faults
def test_a_disk_without_room_for_a_recording(tmp_path, out):
    """What a recording needs is looked for before it begins."""
    prepare, _ = full(out, 900_000)
    options = ("--scenario", "1a", "--method", "shortest", "--time-limit", "4", "--out", str(out))
    work = Workplace(tmp_path / "work", Case(("-m", "minirobots", "run", *options), ()))
    status, errors = work.end(prepare)
    assert (status, errors.count("\n")) == (2, 1)
    assert "MB are free" in errors or "ulimit" in errors
    assert not list(out.rglob("*.rrd"))
