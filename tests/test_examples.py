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


def run_page(name: str) -> str:
    """Run the Python of a page as one session, and return the page."""
    page, names = (DOCS / name).read_text("utf-8"), {"__name__": "session"}
    for block in re.findall(r"^```python\n(.*?)^```$", page, re.M | re.S):
        exec(compile(block, f"docs/{name}", "exec"), names)
    return page


def test_api_page_runs_as_written(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    run_page("api.md")
    assert "rad/s 20.0 ('D', 'E')" in capsys.readouterr().out
    files = {path.name for path in tmp_path.iterdir()}
    assert files == {"policy.npz", "policy.json", "ep.rrd", "lighter.toml"}


@pytest.mark.slow
def test_study_page_runs_as_written(tmp_path, monkeypatch, capsys, command):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    page = run_page("studies.md")
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
    outputs = [out for cell in notebook.cells for out in cell.get("outputs", ())]
    kinds = {kind for out in outputs for kind in out.get("data", ())}
    assert {"image/png", "application/vnd.jupyter.widget-view+json"} <= kinds
