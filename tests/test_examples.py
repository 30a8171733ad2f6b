"""The examples of docs/: pages followed as they stand, docstrings, and every notebook."""

import doctest
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import nbformat
import numpy as np
import pytest
from nbclient import NotebookClient
from pyarrow import parquet

import agent
import minirobots as mr
from agent.study.store import FILE, export
from analysis.motor.step_test import LOOPS
from analysis.reading.motor_test import read
from cosim.model.preset import find_preset
from cosim.model.scenario_file import find_in_world
from cosim.onboard.features import Observation
from docs.examples import assumptions

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


@pytest.mark.ci
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
def test_assumptions_are_varied_one_at_a_time(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["assumptions", "--trainings", "1", "--episodes", "1"])
    monkeypatch.setattr(assumptions, "OPTIONS", {"noise": [0.1]})
    monkeypatch.setattr(assumptions, "WORLD", {})
    monkeypatch.setattr(assumptions, "MACHINE", {"com_height_m": [0.01]})
    assumptions.main()
    rows = [line for line in capsys.readouterr().out.splitlines() if "| paper " in line]
    assert len(rows) == 2
    varied = find_preset("runs/assumptions/com_height_m-0.01.toml").config()
    usual = find_preset("paper").config()
    assert varied.robot == usual.robot._replace(com_height_m=0.01)


class _North:
    def act(self, observation: Observation) -> np.ndarray:
        return np.full(len(observation.cells), 2)


@pytest.mark.long
@pytest.mark.parametrize("path", sorted((DOCS / "examples").glob("*.toml")), ids=lambda p: p.stem)
def test_a_file_of_the_examples_is_one_of_an_episode(path):
    """A scenario, or a world: robots drive for one RL step."""
    of_board = tomllib.loads(path.read_text("utf-8")).keys() != {"world"}
    board, world = find_in_world(path if of_board else "2", None if of_board else path)
    options = {"record": "summary", "progress": None, "time_limit": 2.0}
    episode = mr.simulate(board, _North(), world=world, **options)
    assert episode.outcome in ("timeout", "out_of_board")
    assert len(episode.signals["/sim/r1/position"].values) > 0


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
