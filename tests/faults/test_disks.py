"""Places where nothing can be written: one sentence, and no file that is not whole."""

import ctypes
import os
import re
import resource
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.faults.killing import CACHED, REMADE, Case, Workplace, errors_of, without_progress

DAC_OVERRIDE, DAC_READ_SEARCH, PR_CAPBSET_DROP = 1, 2, 24
FULL_BYTES = 1000
DISK_BYTES = 1 << 20  # of a disk
TRAIN = ("-m", "minirobots", "train", "--jobs", "1", "--scenario", "1a",
         "--learning.episodes", "2000", "--learning.epsilon-episodes", "10")  # fmt: skip
COMMANDS = {
    "excitation": ("-m", "minirobots", "identify-robot", "--excite", "OUT/a.csv"),
    "training": (*TRAIN, "--out", "OUT/a"),
    "FMU": ("-m", "minirobots", "fmu", "--model", "VibrationMotor", "--out", "OUT/a"),
}
MARKED = [pytest.param(name, marks=pytest.mark.faults) for name in COMMANDS]
ALL = ["excitation", *MARKED[1:]]  # the first one costs little


def powerless() -> None:
    """Have permissions hold for root, too: what is executed next cannot override them."""
    for capability in (DAC_OVERRIDE, DAC_READ_SEARCH):
        ctypes.CDLL(None).prctl(PR_CAPBSET_DROP, capability, 0, 0, 0)  # others have it not


def limited() -> None:
    """Let no file grow beyond what a small one has: writes fail as on a full disk."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (FULL_BYTES, FULL_BYTES))


def write_in(
    tmp_path: Path, name: str, prepare: Callable[[], None], out: str = "out"
) -> tuple[int, str]:
    """Run a command in the folder `out`; its status and what it said on stderr."""
    place = Workplace(tmp_path / "work", Case(COMMANDS[name], ()))
    place.out = tmp_path / out
    arguments = [a.replace("OUT", str(place.out)) for a in place.case.arguments]
    done = subprocess.run(
        [sys.executable, *arguments],
        capture_output=True,
        text=True,
        env=place.environment,
        preexec_fn=prepare,
        check=False,
    )
    return done.returncode, without_progress(done.stderr)


def refused(ended: tuple[int, str], out: Path, said: str) -> None:
    status, errors = ended
    assert status == 2, errors
    assert errors.startswith("error: ")
    assert errors.count("\n") == 1
    assert str(out) in errors
    assert re.search(said, errors)
    assert [p for p in out.parent.rglob("*") if ".tmp-" in p.name] == []


@pytest.mark.parametrize("name", ALL)
def test_no_permission(tmp_path, name):
    out = tmp_path / "out"
    out.mkdir(mode=0o555)
    refused(write_in(tmp_path, name, powerless), out, "permission denied; choose another place")
    assert list(out.iterdir()) == []


@pytest.mark.parametrize("name", MARKED)
def test_a_file_where_a_folder_should_be(tmp_path, name):
    (tmp_path / "out").touch()
    refused(write_in(tmp_path, name, powerless), tmp_path / "out", "choose another place")
    assert (tmp_path / "out").read_bytes() == b""


@pytest.mark.parametrize("name", MARKED)
def test_missing_parents_are_made(tmp_path, name):
    status, errors = write_in(tmp_path / "deep", name, lambda: None)
    assert status == 0, errors
    assert list((tmp_path / "deep" / "out").iterdir())


@pytest.mark.parametrize("name", ALL)
def test_a_name_that_is_too_long(tmp_path, name):
    ended = write_in(tmp_path, name, lambda: None, "a" * 300)
    refused(ended, tmp_path / ("a" * 300), "its name is longer than the file system allows")


@pytest.mark.faults
def test_files_may_not_grow(tmp_path):
    out = tmp_path / "out"
    refused(write_in(tmp_path, "excitation", limited), out, "ulimit -f")


@pytest.fixture
def disk(tmp_path):
    """Makes `out` a small disk, full but for some bytes, or one that is read-only.

    Where this user may not mount anything, limits and permissions stand in for it.
    """
    out = tmp_path / "out"
    out.mkdir()

    def make(free_bytes: int | None) -> tuple[Callable[[], None], str]:
        mount = ("mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES}", "tmpfs", str(out))
        mounted = not os.geteuid() and not subprocess.run(mount, check=False).returncode
        if free_bytes is None:
            if not mounted:
                out.chmod(0o555)
                return powerless, "permission denied"
            subprocess.run(("mount", "-o", "remount,ro", str(out)), check=True)
            return lambda: None, "the file system is read-only"
        if not mounted:
            return limited, "free some|ulimit -f"
        (out / "other").write_bytes(bytes(DISK_BYTES - free_bytes))
        return lambda: None, "free some space"

    yield make
    if out.is_mount():
        subprocess.run(("umount", str(out)), check=True)


@pytest.mark.parametrize("name", MARKED)
def test_a_read_only_disk(tmp_path, disk, name):
    prepare, said = disk(None)
    refused(write_in(tmp_path, name, prepare), tmp_path / "out", said)


@pytest.mark.parametrize("name", ALL)
def test_a_full_disk(tmp_path, disk, name):
    prepare, said = disk(0)
    refused(write_in(tmp_path, name, prepare), tmp_path / "out", said)


@pytest.mark.faults
@pytest.mark.parametrize("megabytes", [1, 3, 8, 20])
def test_a_cache_on_a_disk_that_fills(tmp_path, megabytes):
    """Runs end in a one-line error or well, whatever the disk has; with room the next goes well.

    Where this user may not mount anything, a limit of file sizes stands in for the disk.
    """
    arguments = ("--method", "paper", "--train-episodes", "20000", "--time-limit", "4")
    case = Case(("-m", "minirobots", "run", "--scenario", "1a", "--out", "OUT", *arguments), CACHED)
    place, other = Workplace(tmp_path / "full", case), Workplace(tmp_path / "other", case)
    size = f"size={megabytes}m"
    mount = ("mount", "-t", "tmpfs", "-o", size, "tmpfs", str(place.cache))
    mounted = not os.geteuid() and not subprocess.run(mount, check=False).returncode
    limit = (megabytes * 10_000, megabytes * 10_000)
    try:
        statuses = []
        for _ in range(5):
            process = place.start(
                None if mounted else lambda: resource.setrlimit(resource.RLIMIT_FSIZE, limit)
            )
            errors = errors_of(process)
            statuses.append(process.returncode)
            if process.returncode:
                assert re.search("free some|ulimit -f", errors), errors
                assert without_progress(errors).count("\n") == 1, errors
            assert not REMADE.search(errors)
        print(f"{megabytes} MB: {statuses}")
        assert set(statuses) <= {0, 2}
        if mounted:
            again = ("mount", "-o", "remount,size=500m", str(place.cache))
            subprocess.run(again, check=True)
        _, errors = place.run()
        assert not REMADE.search(errors)
        other.environment["MINIROBOTS_CACHE"] = str(place.cache)
        _, errors = other.run()
        assert not REMADE.search(errors)
        assert other.files() == place.files()
        assert not [path for path in place.cache.rglob("*.tmp-*") if path.is_file()]
    finally:
        if mounted:
            subprocess.run(("umount", str(place.cache)), check=True)


@pytest.mark.faults
def test_a_disk_without_room_for_a_recording(tmp_path, disk):
    """What a recording needs is looked for before it begins."""
    prepare, _ = disk(900_000)
    place = Workplace(tmp_path / "work", Case(("-m", "minirobots", "run"), ()))
    done = subprocess.run(
        [sys.executable, "-m", "minirobots", "run", "--scenario", "1a", "--method", "shortest",
         "--time-limit", "4", "--out", tmp_path / "out"],
        capture_output=True, text=True, env=place.environment, preexec_fn=prepare, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "MB are free" in done.stderr or "ulimit" in done.stderr
    assert not list((tmp_path / "out").rglob("*.rrd"))
