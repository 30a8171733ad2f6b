"""The examples of docs/: the page on the Python API as one session, and every notebook."""

import doctest
import re
import sys
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

import agent

DOCS = Path(__file__).parents[1] / "docs"
NOTEBOOKS = sorted((DOCS / "notebooks").glob("*.ipynb"))


def test_api_page_runs_as_written(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(
        r"^```python\n(.*?)^```$", (DOCS / "api.md").read_text("utf-8"), re.M | re.S
    )
    names: dict[str, object] = {"__name__": "session"}
    for block in blocks:
        exec(compile(block, "docs/api.md", "exec"), names)
    assert "rad/s 20.0 ('D', 'E')" in capsys.readouterr().out
    assert {path.name for path in tmp_path.iterdir()} == {
        "policy.npz",
        "policy.json",
        "ep.rrd",
        "lighter.toml",
    }


@pytest.mark.slow
def test_study_page_runs_as_written(tmp_path, monkeypatch, capsys, command):
    page = (DOCS / "studies.md").read_text("utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    names: dict[str, object] = {"__name__": "session"}
    for block in re.findall(r"^```python\n(.*?)^```$", page, re.M | re.S):
        exec(compile(block, "docs/studies.md", "exec"), names)
    said = capsys.readouterr().out
    assert "| fastest | 1a | 0.15 | 4 | 100.0% [" in said
    assert "0.0 0.0 0.56" in said
    assert said.rstrip().endswith("[2 rows x 8 columns]")
    (file,) = re.findall(r'^```toml title="friction.toml"\n(.*?)^```$', page, re.M | re.S)
    Path("friction.toml").write_text(file)
    done = command("study", "friction.toml")  # finds the episodes of the page's Python
    assert done.returncode == 0, done.stderr
    assert Path("friction.png").stat().st_size > 5000


def test_examples_of_docstrings_hold(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = doctest.testmod(agent)
    assert (found.failed, found.attempted) == (0, 8)


@pytest.mark.long
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs(path, tmp_path):
    notebook = nbformat.read(path, as_version=4)
    assert not any(cell.get("outputs") for cell in notebook.cells)  # kept small in the repository
    context = {"metadata": {"path": str(tmp_path)}}
    NotebookClient(notebook, timeout=300, resources=context).execute()
    kinds = {
        kind
        for cell in notebook.cells
        for out in cell.get("outputs", ())
        for kind in out.get("data", ())
    }
    assert {"image/png", "application/vnd.jupyter.widget-view+json"} <= kinds
