"""The façade: a fast import, types, examples that hold, and folders of the user's own."""

import doctest
import os
import subprocess
import sys
from pathlib import Path

import pytest

import minirobots as mr

ROOT = Path(__file__).parents[2]
# A user's script: its folder has folders of the names of our packages, with modules of the user's.
SCRIPT = """
import minirobots as mr
import agent
print(mr.UserError.__module__, mr.__version__, agent.__file__)
"""


def test_import_takes_no_time():
    program = (
        "import sys, time; before = set(sys.modules); t = time.perf_counter(); import minirobots;"
        "print(time.perf_counter() - t); print(*(set(sys.modules) - before))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    loaded = done.stdout.splitlines()[1].split()
    ours = {name for name in loaded if name.split(".")[0] in {"agent", "analysis", "cosim", "fmus"}}
    assert ours == set()
    assert not {"numpy", "numba", "tyro"}.intersection(loaded)


def test_all_names_are_there_and_no_others():
    assert [name for name in mr.__all__ if not hasattr(mr, name)] == []
    assert dir(mr) == sorted(mr.__all__)
    with pytest.raises(AttributeError, match="no attribute 'fly'"):
        getattr(mr, "fly")  # noqa: B009 - not an attribute that pyright knows


@pytest.mark.parametrize("name", sorted({*mr.__all__, ""} - {"__version__"}))
def test_examples_hold(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    thing = getattr(mr, name) if name else mr
    (test,) = doctest.DocTestFinder(recurse=False).find(thing, name or "mr", module=False, globs={})
    assert test.examples
    found = doctest.DocTestRunner(optionflags=doctest.REPORT_NDIFF).run(test)
    assert found.failed == 0


def test_folders_of_a_user_do_not_hide_ours(tmp_path):
    """A namespace package gives way to a regular one, wherever they are on the path."""
    for name in ("agent", "analysis", "fmus", "cosim"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "mine.py").write_text("")
    (tmp_path / "script.py").write_text(SCRIPT)
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    for arguments in (["script.py"], ["-c", "import script"], ["-m", "script"]):
        done = subprocess.run(
            [sys.executable, *arguments],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        module, version, file = done.stdout.split()
        assert (module, version) == ("cosim.base.errors", mr.__version__)
        assert not Path(file).is_relative_to(tmp_path)
    listed = subprocess.run(
        [sys.executable, "-m", "minirobots"], cwd=tmp_path, env=environment, check=False
    )
    assert listed.returncode == 0
