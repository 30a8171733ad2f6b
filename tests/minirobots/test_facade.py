"""The façade: a fast import, types, examples that hold, and folders of the user's own."""

import doctest
import os
from pathlib import Path

import pytest

import minirobots as mr
from tests.alone import python

# A user's script: its folder has folders of the names of our packages, with modules of the user's.
SCRIPT = """
import minirobots as mr
import agent
print(mr.UserError.__module__, mr.__version__, agent.__file__)
"""


def test_import_loads_nothing():
    program = (
        "import sys; before = {*sys.modules}; import minirobots; print(*{*sys.modules}-before)"
    )
    loaded = {name.partition(".")[0] for name in python("-c", program, check=True).stdout.split()}
    slow = {"agent", "analysis", "cosim", "fmus", "numpy", "numba", "tyro"}
    assert loaded.isdisjoint(slow)


def test_all_names_are_there_and_no_others():
    assert [name for name in mr.__all__ if not hasattr(mr, name)] == []
    assert dir(mr) == sorted(mr.__all__)
    with pytest.raises(AttributeError, match="no attribute 'fly'"):
        getattr(mr, "fly")  # noqa: B009 - not an attribute that pyright knows


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.long if name in ("evaluate", "study") else ())
        for name in sorted({*mr.__all__, ""} - {"__version__"})
    ],
)
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
        done = python(*arguments, cwd=tmp_path, env=environment, check=True)
        module, version, file = done.stdout.split()
        assert (module, version) == ("cosim.base.errors", mr.__version__)
        assert not Path(file).is_relative_to(tmp_path)
    assert python("-m", "minirobots", cwd=tmp_path, env=environment).stdout
