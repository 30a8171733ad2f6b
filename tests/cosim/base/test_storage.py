"""The cache mends itself, files are whole or absent, and nothing is left beside them."""

import json
import logging
import os
import re
import signal
import tempfile
from pathlib import Path

import pytest

from cosim.base.errors import FileError
from cosim.base.storage import cached, replacing, write_json
from tests.alone import python, started
from tests.faults.test_disks import powerless as without_power

KEPT = "kept"


def from_cache(path, made):
    """What the cache has; appends to `made` when it is made."""

    def make():
        made.append(KEPT)
        return KEPT

    def save(value, to):
        with replacing(to) as temporary:
            temporary.write_text(value)

    return cached(path, lambda p: p.read_text(), make, save)


def test_what_is_in_the_cache_is_not_made_again(tmp_path, caplog):
    made = []
    for _ in range(2):
        assert from_cache(tmp_path / "file", made) == KEPT
    assert made == [KEPT]
    (tmp_path / "file").unlink()
    assert from_cache(tmp_path / "file", made) == KEPT
    assert made == [KEPT] * 2
    assert not caplog.records  # nothing was damaged


@pytest.mark.parametrize(
    "damage",
    [
        lambda p: p.write_bytes(b""),
        lambda p: p.write_bytes(p.read_bytes()[:2]),
        lambda p: p.write_bytes(bytes(range(256))),
        lambda p: p.write_bytes(b"kepu"),
        lambda p: p.write_bytes(b"[]"),
        lambda p: p.with_name("file.sha256").write_bytes(b"\xff"),
        lambda p: p.with_name("file.sha256").write_text("0"),
        lambda p: p.with_name("file.sha256").unlink(),
    ],
)
def test_a_damaged_file_is_made_again(tmp_path, caplog, damage):
    made = []
    path = tmp_path / "file"
    from_cache(path, made)
    damage(path)
    with caplog.at_level(logging.WARNING):
        assert from_cache(path, made) == KEPT
    assert len(made) == 2
    assert f"{path} is corrupted" in caplog.text
    from_cache(path, made)
    assert len(made) == 2


def test_a_file_that_may_not_be_read_is_made_again():
    """As another user: nothing is forbidden to root, and its pytest's folders are to all others."""
    script = (
        "import os, sys; from pathlib import Path; from cosim.base.storage import cached;"
        "path = Path(sys.argv[1], 'file'); path.parent.chmod(0o777);"
        "os.geteuid() == 0 and os.setuid(65534);"
        "save = lambda value, to: to.unlink(missing_ok=True) or to.write_text(value);"
        "get = lambda: cached(path, Path.read_text, lambda: print('made') or 'x', save);"
        "get(); path.chmod(0); get()"
    )
    with tempfile.TemporaryDirectory() as folder:
        run = python("-c", script, folder)
    assert run.stdout == "made\nmade\n", run.stderr


USED = """
import sys
from pathlib import Path
from cosim.base.errors import run_command
from cosim.base.jit import kernel
from cosim.base.storage import cache_dir, cached

@kernel
def doubled(value):
    return NUMBER * value

def main():
    path = cache_dir("bounds") / sys.argv[1]
    print(cached(path, Path.read_text, lambda: "x", lambda value, to: to.write_text(value)))
    print(doubled(float(sys.argv[2])) if sys.argv[2] == "1" else doubled(3))

run_command(main)
"""


@pytest.mark.long
def test_a_cache_that_cannot_be_written_is_used_as_far_as_it_goes(tmp_path):
    script, cache = tmp_path / "use.py", tmp_path / "cache"
    script.write_text(USED.replace("NUMBER", "2.5"))

    def use(*arguments, folder=cache, powerless=True):
        env = os.environ | {"MINIROBOTS_CACHE": str(folder)}
        prepare = without_power if powerless else None
        done = python(script, *arguments, env=env, preexec_fn=prepare)
        return done.returncode, done.stdout, done.stderr

    assert use("a", "1", powerless=False) == (0, "x\n2.5\n", "")
    for folder in (cache, *(path for path in cache.rglob("*") if path.is_dir())):
        folder.chmod(0o555)
    said = "the cache cannot be written; set MINIROBOTS_CACHE to a folder that can be\n"
    assert use("a", "1") == (0, "x\n2.5\n", "")
    assert use("b", "1") == (2, "", f"error: {cache / 'bounds'}: {said}")
    (kernels,) = (cache / "kernels").iterdir()
    assert use("a", "2") == (2, "x\n", f"error: {kernels}: {said}")
    other = Path("/proc/cache")
    assert use("a", "1", folder=other) == (2, "", f"error: {other / 'bounds'}: {said}")


@pytest.mark.skipif(os.geteuid() != 0, reason="becomes a user without an entry in passwd")
def test_a_user_without_a_home_folder_is_told_of_the_variable():
    script = (
        "import os; from cosim.base.errors import run_command;"
        "from cosim.base.storage import cache_dir, lock_of; os.setuid(54321);"
        "run_command(lambda: print(lock_of(cache_dir('bounds') / 'a')))"
    )
    env = {k: v for k, v in os.environ.items() if k not in ("HOME", "MINIROBOTS_CACHE")}
    done = python("-c", script, env=env)
    assert (done.returncode, done.stdout) == (2, "")
    assert re.fullmatch(r"error: .*/bounds: .* set MINIROBOTS_CACHE .*\n", done.stderr)


def test_a_folder_in_the_place_of_a_file_is_named(tmp_path):
    made = []
    (tmp_path / "file").mkdir()
    with pytest.raises(FileError, match=r"file: a folder is where this file goes"):
        from_cache(tmp_path / "file", made)
    assert not made  # not found out after hours of training


def writer(path, what):
    """A process in the middle of writing a file."""
    script = (
        "import sys, time; from pathlib import Path;"
        "from cosim.base.errors import run_command; from cosim.base.storage import replacing\n"
        "def main():\n"
        "    with replacing(Path(sys.argv[1])) as temporary:\n"
        "        temporary.write_text('half')\n"
        "        print('writing', flush=True)\n"
        f"        {what}\n"
        "run_command(main)"
    )
    process, said = started("-c", script, path)
    assert said == "writing\n"
    return process


@pytest.mark.parametrize(("how", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_an_interrupted_process_leaves_nothing(tmp_path, how, status):
    # A signal that comes just before a sleep is seen after it: many short ones.
    process = writer(tmp_path / "result.npz", "for _ in range(600): time.sleep(0.1)")
    process.send_signal(how)
    _, errors = process.communicate(timeout=300)
    assert (process.returncode, errors) == (status, "interrupted\n")
    assert not list(tmp_path.iterdir())


def test_what_a_killed_process_left_is_swept_and_nothing_else(tmp_path):
    path = tmp_path / "result.npz"
    killed = writer(path, "time.sleep(60)")
    killed.kill()
    killed.communicate()
    assert len(list(tmp_path.iterdir())) == 1
    living = writer(path, "time.sleep(60)")  # sweeps what the killed one left
    (temporary,) = tmp_path.iterdir()
    other = tmp_path / ".result.npz"
    other.touch()
    with replacing(path) as mine:
        mine.write_text("whole")
    assert {*tmp_path.iterdir()} == {path, temporary, other}
    living.kill()
    living.communicate()
    with replacing(path) as mine:
        mine.write_text("again")
    assert {*tmp_path.iterdir()} == {path, other}
    assert path.read_text() == "again"


def test_every_name_that_the_file_system_allows_can_be_written(tmp_path):
    path = tmp_path / ("ä" * 120 + ".json")
    with replacing(path) as temporary:
        temporary.write_text("whole")
    assert path.read_text() == "whole"
    with (
        pytest.raises(OSError, match="File name too long") as raised,
        replacing(tmp_path / ("a" * 300)) as temporary,
    ):
        temporary.write_text("whole")
    assert raised.value.filename == str(tmp_path / ("a" * 300))
    assert [*tmp_path.iterdir()] == [path]


def test_json_has_lists_of_numbers_on_one_line(tmp_path):
    content = {
        "cells": [[[1, 2], [-3, 4.5e-9]], [[0, 0]]],
        "words": ["a", "b [\n1,\n 2\n]"],
        "rows": [{"a": 1, "starts": [[1, 2], [3, 4]], "b": []}, {"a": [1, None, True]}],
    }
    write_json(tmp_path / "a.json", content)
    text = (tmp_path / "a.json").read_text()
    assert json.loads(text) == content
    assert '"cells": [[[1,2],[-3,4.5e-9]],[[0,0]]],\n' in text
    assert '"starts": [[1,2],[3,4]],\n' in text
    assert '"a",\n' in text


def test_files_are_as_readable_as_the_umask_allows(tmp_path, monkeypatch):
    before = os.umask(0o027)
    try:
        monkeypatch.setattr(os, "umask", None)  # which would be that of all threads
        write_json(tmp_path / "a.json", [])
    finally:
        monkeypatch.undo()
        os.umask(before)
    assert (tmp_path / "a.json").stat().st_mode & 0o777 == 0o640


WITHOUT_POSIX = """
import os, sys
sys.modules["fcntl"] = None
del os.sched_getaffinity
from pathlib import Path
import agent, analysis, cosim, minirobots, agent.study.store
from cosim.base.command import workers
from cosim.base.storage import write_json
write_json(Path("a.json"), [1])
print(Path("a.json").read_text(), workers(-1) > 0)
"""


@pytest.mark.long
def test_files_are_written_without_what_only_posix_systems_have(tmp_path):
    done = python("-W", "ignore", "-c", WITHOUT_POSIX, cwd=tmp_path)
    assert (done.stdout, done.stderr) == ("[1]\n True\n", "")
