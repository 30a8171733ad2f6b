"""Commands that are killed: their smallest real cases, and what they have written to compare."""

import json
import os
import re
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pyarrow import parquet

from cosim.base.storage import cache_dir
from cosim.recording.reader import read_rrd

CACHED = ("kernels", "calibrations", "fmus", "moves", "policies", "bounds")
# What depends on the clock, by its name in JSON.
OF_THE_CLOCK = {
    "attempts", "cores", "episode_wall_s", "issued", "realtime_factor", "seconds",
    "simulated", "wall_s",
}  # fmt: skip
# What the log says of a file of the cache that is not whole.
REMADE = re.compile("is corrupted|is damaged")
TIMES = re.compile(rb"<caption><strong>Time\.</strong>.*?</table>", re.DOTALL)
STUDY = """
policies = ["shortest"]
scenario = "1a"
episodes = 4
noise = [0.0, 0.05]
time_limit = 20.0
"""
# Draws results that are elsewhere.
REPORT = """
import sys
from pathlib import Path
from minirobots.__main__ import main
results, out = map(Path, sys.argv[1:])
out.mkdir(parents=True, exist_ok=True)
if not (out / "results").exists():
    (out / "results").symlink_to(results)
sys.argv = ["minirobots", "reproduce", "--out", str(out), "--report-only"]
main()
"""
TINY = """
import runpy, sys
from pathlib import Path
from cosim.base.errors import run_command
tests = runpy.run_path(sys.argv[1])
import pytest
from minirobots.reproduction import reproduce
with pytest.MonkeyPatch.context() as patch:
    tests["evaluate_seldom"](patch)
    run_command(lambda: reproduce(Path(sys.argv[2]), tests["TINY"], seed=0, jobs=2, say=print))
"""


class Case(NamedTuple):
    """A command.

    Attributes:
        arguments: of Python; OUT in them is the folder of results.
        fresh: kinds of things that its cache does not have at first.
    """

    arguments: tuple[str, ...]
    fresh: tuple[str, ...] = ("policies", "bounds")


class Workplace:
    """A folder of results, and a cache that has of the user's what the command may find there."""

    def __init__(self, folder: Path, case: Case) -> None:
        self.case, self.out, self.cache = case, folder / "out", folder / "cache"
        (folder / "temporary").mkdir(parents=True)
        self.environment = os.environ | {
            "MINIROBOTS_CACHE": str(self.cache),
            "TMPDIR": str(folder / "temporary"),
        }
        self.cache.mkdir()
        for kind in CACHED:
            if kind not in case.fresh:
                (self.cache / kind).symlink_to(cache_dir(kind), target_is_directory=True)

    def start(self, prepare: Callable[[], None] | None = None) -> subprocess.Popen[str]:
        arguments = [a.replace("OUT", str(self.out)) for a in self.case.arguments]
        return subprocess.Popen(
            [sys.executable, *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=self.environment,
            start_new_session=True,
            preexec_fn=prepare,  # noqa: PLW1509 - of one thread
        )

    def end(self, prepare: Callable[[], None] | None = None) -> tuple[int, str]:
        """Run the command to its end; its status, and what it said on stderr."""
        process = self.start(prepare)
        errors = errors_of(process)
        return process.returncode, errors

    def run(self) -> tuple[float, str]:
        """Run the command to its end; the time that it took in s, and what it said on stderr."""
        began = time.perf_counter()
        status, errors = self.end()
        assert status == 0, errors
        return time.perf_counter() - began, errors

    def kill(self, moment_s: float) -> None:
        """Start the command, and kill all its processes after a time."""
        process = self.start()
        try:
            process.communicate(timeout=moment_s)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()

    def files(self) -> dict[str, Any]:
        """What every file of the results says; None if its name says that it is not whole."""
        paths = sorted(
            p for p in self.out.rglob("*") if p.is_file() and p.suffix != ".sqlite-journal"
        )
        return {
            str(path.relative_to(self.out)): None
            if path.name.startswith(".") or path.suffix == ".part"
            else outcome_of(path, self.out)
            for path in paths
        }


def errors_of(process: subprocess.Popen[str]) -> str:
    """Return what a process wrote to stderr until its end; an interrupted test ends it too."""
    try:
        return process.communicate()[1]
    except BaseException:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        raise


def without_progress(errors: str) -> str:
    """What a command said on stderr, but for the lines that announce what takes long."""
    return "".join(line for line in errors.splitlines(True) if not line.endswith(" …\n"))


def outcome_of(path: Path, out: Path) -> Any:
    """What a file of results says, whenever and wherever it was written.

    Raises:
        Exception: it is not whole.
    """
    if path.suffix == ".npz":
        with np.load(path) as file:
            return {
                name: (array.dtype, array.shape, array.tobytes()) for name, array in file.items()
            }
    if path.suffix == ".rrd":
        data = read_rrd(path)
        assert data.complete
        signals = {k: (s.time_s.tobytes(), s.values.tobytes()) for k, s in data.signals.items()}
        texts = {k: (t.time_s.tobytes(), t.texts) for k, t in data.texts.items()}
        return data.recording_id, signals, texts
    if path.suffix == ".parquet":
        return timeless(parquet.read_table(path).to_pylist())
    content = path.read_bytes().replace(str(out).encode(), b"OUT")
    if path.suffix == ".json":
        return timeless(json.loads(content))
    if path.suffix == ".sqlite":
        if not content:  # killed before its first row
            return []
        with sqlite3.connect(path) as file:
            rows = file.execute("SELECT * FROM episodes ORDER BY digest, start").fetchall()
        return [(case, start, timeless(json.loads(result))) for case, start, result in rows]
    if path.suffix == ".html":  # the report's table of how long it took
        return TIMES.sub(b"", content)
    return content


def timeless(value: Any) -> Any:
    """A value of JSON without what depends on the clock."""
    if isinstance(value, dict):
        return {k: timeless(v) for k, v in value.items() if k not in OF_THE_CLOCK}
    return [timeless(v) for v in value] if isinstance(value, list) else value


def cases(trained: Path, reproduced: Path) -> dict[str, Case]:
    """All commands that are killed.

    Args:
        trained: results of the training, whose policy is evaluated.
        reproduced: results of the reproduction, which are reported.
    """
    study = trained.parent / "noise.toml"
    study.write_text(STUDY)
    policy, results = trained / "run_000" / "policy.npz", reproduced / "results"
    short = ("--scenario", "1a", "--learning.episodes", "200000")
    sweep = ("train", "--runs", "3", "--jobs", "2", *short)
    conftest = Path(__file__).parents[1] / "analysis" / "conftest.py"
    return {
        "training": Case(("-m", "minirobots", "train", "--jobs", "1", "--out", "OUT", *short)),
        "sweep": Case(("-m", "minirobots", *sweep, "--out", "OUT")),
        "evaluation": Case(
            ("-m", "minirobots", "evaluate", str(policy), "--starts", "8", "--recordings", "1",
             "--time-limit", "20", "--jobs", "2", "--out", "OUT")
        ),
        "study": Case(("-m", "minirobots", "study", str(study), "--jobs", "2", "--out", "OUT")),
        "report": Case(("-c", REPORT, str(results), "OUT")),
        "FMU": Case(("-m", "minirobots", "fmu", "motor", "--out", "OUT")),
        "kernels": Case(
            ("-m", "minirobots", "train", "--jobs", "1", "--out", "OUT", "--scenario", "1a",
             "--learning.episodes", "2000"),
            ("kernels", "policies", "bounds"),
        ),
        "reproduction": Case(("-c", TINY, str(conftest), "OUT")),
    }  # fmt: skip
