"""What all tests share: cache, motor FMU, hypothesis' profiles, commands, an untrained policy."""

import contextlib
import io
import math
import os
import shutil
import signal
import sys
import tempfile
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from xdist.scheduler import LoadScopeScheduling

from cosim.base.storage import cache_dir

if TYPE_CHECKING:
    from cosim.onboard.features import Observation

# First calls compile kernels, and machines are busy: nothing is judged by the time it takes.
settings.register_profile(
    "minirobots",
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
    derandomize="CI" in os.environ,  # elsewhere every run tries other examples
)
settings.register_profile("nightly", settings.get_profile("minirobots"), max_examples=5000)
settings.load_profile("minirobots")


def pytest_configure(config: pytest.Config) -> None:
    """Give the session, all its workers together, a cache apart from the user's own.

    Policies and FMUs are made anew; kernels and calibrations are shared with the user's cache.
    """
    # What a shell starts in the background ignores Ctrl-C, and so would the commands under test.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    if "MINIROBOTS_CACHE" not in os.environ:  # workers inherit that of their session
        folder = Path(tempfile.mkdtemp(prefix="minirobots-"))
        for kind in ("kernels", "calibrations"):
            (folder / kind).symlink_to(cache_dir(kind), target_is_directory=True)
        os.environ["MINIROBOTS_CACHE"] = str(folder)

        def forget() -> None:
            del os.environ["MINIROBOTS_CACHE"]
            shutil.rmtree(folder, ignore_errors=True)  # a process that compiles may go on

        config.add_cleanup(forget)
    if sys.dont_write_bytecode:
        _keep_bytecode(config)


def _keep_bytecode(config: pytest.Config) -> None:
    """Where Python is told to keep no bytecode, keep it for the session: commands start often."""
    folder = tempfile.mkdtemp(prefix="minirobots-bytecode-")
    patch = pytest.MonkeyPatch()
    patch.delenv("PYTHONDONTWRITEBYTECODE", raising=False)
    patch.setenv("PYTHONPYCACHEPREFIX", folder)
    patch.setattr(sys, "pycache_prefix", folder)
    patch.setattr(sys, "dont_write_bytecode", False)
    config.add_cleanup(lambda: shutil.rmtree(folder, ignore_errors=True))  # some may still write
    config.add_cleanup(patch.undo)


@pytest.hookimpl(trylast=True)  # of what is not deselected
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with two files that compile the coupled loop, for pairs and for more robots, at once.

    Then with those of which a test takes long: workers share short ones evenly at the end.
    """
    compiling = {"test_drive.py", "test_episode.py"}
    taking = [
        item for item in items if {mark.name for mark in item.iter_markers()} & {"ci", "long"}
    ]
    long = {item.path for item in taking}
    items.sort(key=lambda item: (item.path.name not in compiling, item.path not in long))


class _ByFixtures(LoadScopeScheduling):
    """Gives a worker all tests that share costly fixtures: a file, or all tests of analysis."""

    def _split_scope(self, nodeid: str) -> str:
        file = nodeid.partition("::")[0]
        return "tests/analysis" if file.startswith("tests/analysis/") else file


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> LoadScopeScheduling:
    """See `_ByFixtures`."""
    return _ByFixtures(config, log)


class Ended(NamedTuple):
    """How a command ended, and what it said."""

    returncode: int
    stdout: str
    stderr: str


@pytest.fixture(scope="session")
def command():
    """Run a command, by its name, or a module with `main`, in this process with its imports."""
    from cosim.base.errors import run_command
    from minirobots.runner import execute

    def run(module: ModuleType | str, *arguments: Any) -> Ended:
        if isinstance(module, str):
            name, main = f"minirobots {module}", partial(execute, module)
        else:
            name, main = module.__name__, module.main
        out, err, status = io.StringIO(), io.StringIO(), 0
        with (
            pytest.MonkeyPatch.context() as patch,
            contextlib.redirect_stdout(out),
            contextlib.redirect_stderr(err),
        ):
            patch.setattr(sys, "argv", [name, *map(str, arguments)])
            try:
                run_command(main)
            except SystemExit as end:
                assert end.code is None or isinstance(end.code, int)
                status = end.code or 0
        return Ended(status, out.getvalue(), err.getvalue())

    return run


@pytest.fixture(scope="session")
def motor_fmu() -> Path:
    from fmus.build import cached_fmu

    return cached_fmu("VibrationMotor")


@pytest.fixture(scope="session")
def array_fmu() -> Path:
    from fmus.build import cached_fmu

    return cached_fmu("VibrationMotors")


def _shown(part: Any, found: set[str]) -> None:
    if hasattr(part, "contents") and hasattr(part, "origin"):
        contents = part.contents if isinstance(part.contents, list) else [part.origin]
        found.update(p.strip("+ ").removesuffix("/**") for p in contents if p[0] != "-")
    else:
        for child in part.contents:
            _shown(child, found)


@pytest.fixture(scope="session")
def shown_paths():
    """Entity paths that the views of a blueprint show."""

    def paths(blueprint) -> set[str]:
        found: set[str] = set()
        _shown(blueprint.root_container, found)
        return found

    return paths


class StraightPolicy:
    """Heads for the target by the shortest path, blind for the other robot."""

    def __init__(self, targets: tuple[tuple[int, int], ...]) -> None:
        self._targets = np.array(targets)

    def act(self, observation: "Observation") -> np.ndarray:
        offset = np.sign(self._targets - observation.cells)
        turns = np.round(np.arctan2(offset[:, 1], offset[:, 0]) / (math.pi / 4.0))
        return turns.astype(int) % 8


@pytest.fixture(scope="session")
def straight_policy() -> type[StraightPolicy]:
    return StraightPolicy
