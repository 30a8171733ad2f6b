"""The tutorial, run as it stands."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from pyarrow import parquet

from agent.study.store import FILE, export
from analysis.motor.step_test import LOOPS
from analysis.reading.motor_test import read

DOCS = Path(__file__).parents[1] / "docs"
BLOCK = re.compile(r'^```(\w+)(?: title="([\w.]+)")?\n(.*?)^```$', re.M | re.S)


@pytest.fixture
def follow(tmp_path, monkeypatch, command):
    """Does what a page says in an empty folder: writes its files, runs its Python and commands."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])

    def follow_page(name: str) -> None:
        names: dict[str, object] = {}
        for language, file, content in BLOCK.findall((DOCS / name).read_text("utf-8")):
            if file:
                Path(file).write_text(content)
            elif language == "python":
                exec(compile(content, name, "exec"), names)
            for line in content.splitlines() if language == "sh" else ():
                program, *arguments = shlex.split(line, comments=True)
                if program == "python":
                    subprocess.run([sys.executable, *arguments], check=True)
                    continue
                assert program == "minirobots"
                done = command(*arguments)
                expected = 2 if line.endswith("# exit status 2") else 0
                assert done.returncode == expected, done.stderr

    return follow_page


@pytest.mark.slow
def test_own_parts_are_brought_as_the_page_says(follow, tmp_path):
    follow("own.md")
    mine, ours = (read(tmp_path / name)[LOOPS[0]].omega for name in ("mine.rrd", "heavier.rrd"))
    assert mine.max() < ours.max() - 5.0  # rad/s, without control: the drag
    assert not (tmp_path / "broken.rrd").exists()


@pytest.mark.long
def test_tutorial_runs_as_written(follow, tmp_path, capsys):
    follow("tutorial.md")
    assert "success after" in capsys.readouterr().out
    runs = tmp_path / "runs"
    for name, expected in (("greedy", "collision"), ("learnt", "success")):
        export(runs / name, runs / "episodes.parquet")
        outcomes = parquet.read_table(runs / "episodes.parquet")["outcome"].to_pylist()
        assert outcomes == [expected] * 10
    assert (runs / "claim" / FILE).exists()  # certified: the command has status 0
    rows = (runs / "friction" / "study.md").read_text().splitlines()[2:]
    assert [row.split(" | ")[0].strip("| ") for row in rows] == ["greedy"] * 2 + ["learnt"] * 2
