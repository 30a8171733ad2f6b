"""The examples of docs/: pages followed as they stand, docstrings, and every notebook."""

import doctest
import re
import shlex
import subprocess
import sys
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient
from pyarrow import parquet

import agent
from agent.study.store import FILE, export
from analysis.motor.step_test import LOOPS
from analysis.reading.motor_test import read

DOCS = Path(__file__).parents[1] / "docs"
NOTEBOOKS = sorted((DOCS / "notebooks").glob("*.ipynb"))
BLOCK = re.compile(r'^```(\w+)(?: title="([\w.]+)")?\n(.*?)^```$', re.M | re.S)


@pytest.fixture
def follow(tmp_path, monkeypatch, command):
    """Does what a page says in an empty folder: writes its files, runs its Python and commands."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])

    def follow_page(page: str, commands: bool = True) -> None:
        names: dict[str, object] = {"__name__": "session"}
        for language, file, content in BLOCK.findall((DOCS / page).read_text("utf-8")):
            if file:
                Path(file).write_text(content)
            elif language == "python":
                exec(compile(content, page, "exec"), names)
            for line in content.splitlines() if language == "sh" and commands else ():
                program, *arguments = shlex.split(line, comments=True)
                if program == "python":
                    subprocess.run([sys.executable, *arguments], check=True)
                    continue
                assert program == "minirobots"
                done = command(*arguments)
                expected = 2 if line.endswith("# exit status 2") else 0
                assert done.returncode == expected, done.stderr

    return follow_page


def test_api_page_runs_as_written(follow, tmp_path, capsys):
    follow("api.md")
    assert "rad/s 20.0 ('D', 'E')" in capsys.readouterr().out
    files = {path.name for path in tmp_path.iterdir()}
    assert files == {"policy.npz", "policy.json", "ep.rrd", "lighter.toml"}


@pytest.mark.slow
def test_study_page_runs_as_written(follow, capsys, command):
    follow("studies.md", commands=False)
    said = capsys.readouterr().out
    assert "| fastest | 1a | 0.15 | – | 4 | 100.0% [" in said
    assert "0.0 0.0 0.56" in said
    assert said.rstrip().endswith("[2 rows x 8 columns]")
    done = command("study", "friction.toml")  # finds the episodes of the page's Python
    assert done.returncode == 0, done.stderr
    assert Path("friction.png").stat().st_size > 5000


@pytest.mark.slow
def test_own_parts_are_brought_as_the_page_says(follow, tmp_path):
    follow("own.md")
    mine, ours = (read(tmp_path / name)[0][LOOPS[0]].omega for name in ("mine.rrd", "heavier.rrd"))
    assert mine.max() < ours.max() - 5.0  # rad/s, without control: the drag
    assert not (tmp_path / "broken.rrd").exists()


@pytest.mark.long
def test_tutorial_runs_as_written(follow, tmp_path, capsys):
    follow("tutorial.md")
    assert "success after" in capsys.readouterr().out
    runs = tmp_path / "runs"
    assert any((runs / "greedy" / "recordings").iterdir())
    assert not (runs / "greedy" / FILE).exists()  # a policy's file is known, an object is not
    export(runs / "learnt", runs / "episodes.parquet")
    outcomes = parquet.read_table(runs / "episodes.parquet")["outcome"].to_pylist()
    assert outcomes == ["success"] * 10
    assert (runs / "claim" / FILE).exists()  # certified: the command has status 0
    rows = (runs / "friction" / "study.md").read_text().splitlines()[2:]
    assert [row.split(" | ")[0].strip("| ") for row in rows] == ["greedy"] * 2 + ["learnt"] * 2


def test_examples_of_docstrings_hold(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = doctest.testmod(agent)
    assert (found.failed, found.attempted) == (0, 9)


@pytest.mark.long
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs(path, tmp_path):
    notebook = nbformat.read(path, as_version=4)
    assert not any(cell.get("outputs") for cell in notebook.cells)  # kept small in the repository
    context = {"metadata": {"path": str(tmp_path)}}
    NotebookClient(notebook, timeout=300, resources=context).execute()
    outputs = [out for cell in notebook.cells for out in cell.get("outputs", ())]
    kinds = {kind for out in outputs for kind in out.get("data", ())}
    assert {"image/png", "application/vnd.jupyter.widget-view+json"} <= kinds
