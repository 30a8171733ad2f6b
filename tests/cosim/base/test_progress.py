"""Progress: nothing of what is quick, bars on a terminal, a line per task elsewhere."""

import contextlib
import io
import os
import pty
import subprocess
import sys
import threading
import time
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient
from nbclient.exceptions import CellTimeoutError
from rich.console import Console

from cosim.base import progress as module
from cosim.base.progress import automatic, progress_bars, showing, silent, under_way


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """What takes a tenth of a second is shown."""
    monkeypatch.setattr(module, "_QUIET_S", 0.1)


def shown(until, terminal=False):
    """Text that a console has when `until`, called with the progress, is over."""
    text = io.StringIO()
    with progress_bars(Console(file=text, force_terminal=terminal, width=80)) as progress:
        until(progress, text)
    return text.getvalue()


def wait_for(text, word):
    began = time.monotonic()
    while word not in text.getvalue():
        assert time.monotonic() - began < 60.0, text.getvalue()
        time.sleep(0.01)


@pytest.mark.parametrize("terminal", [False, True])
def test_nothing_is_shown_of_what_is_quick(terminal):
    assert shown(lambda progress, _: progress("training", 0, None), terminal) == ""


def test_each_long_task_has_one_line_without_a_terminal():
    def work(progress, text):
        progress("quick", 1, 1)
        with under_way(progress, "calibrating"):
            wait_for(text, "calibrating")
        for done in range(3):
            progress("training [b]", done, 3)
            wait_for(text, "training")
            time.sleep(0.15)
        progress("training [b]", 3, 3)

    assert shown(work) == "calibrating …\ntraining [b] …\n"


def test_bars_are_drawn_on_a_terminal():
    def work(progress, text):
        progress("training", 1, 4, "some state")
        wait_for(text, "some state")
        progress("training", 4, 4, "the end")

    text = shown(work, terminal=True)
    assert "\x1b[" in text
    assert text.rindex("the end") > text.index("some state")  # the last report is drawn


@showing
def call(work, *, progress=automatic):
    work(progress)
    return progress


@pytest.mark.long
def test_a_call_shows_its_progress_by_default(capsys):
    def work(progress):
        progress("working", 0, 2)
        time.sleep(1.0)

    assert call(work) not in {automatic, silent}
    assert capsys.readouterr() == ("", "working …\n")
    assert call(work, progress=None) is silent
    seen = []
    call(work, progress=lambda *report: seen.append(report))
    assert seen == [("working", 0, 2)]
    assert capsys.readouterr() == ("", "")
    assert [t for t in threading.enumerate() if t.name.endswith("(_show)")] == []


def test_an_error_ends_the_bars():
    with pytest.raises(ZeroDivisionError), progress_bars() as progress:
        progress("working", 0, 2)
        raise ZeroDivisionError
    assert [t for t in threading.enumerate() if t.name.endswith("(_show)")] == []


@pytest.mark.long
def test_a_command_draws_bars_on_its_terminal():
    script = (
        "import ipywidgets, rich.progress, time\n"  # whose imports take longer than the work
        "from cosim.base import progress; from cosim.base.errors import run_command\n"
        "progress._QUIET_S = 0.1\n"
        "def main():\n"
        "    with progress.progress_bars() as report:\n"
        "        report('working', 1, 2)\n"
        "        time.sleep(1)\n"
        "run_command(main)"
    )
    ours, theirs = pty.openpty()
    environment = os.environ | {"TERM": "xterm"}
    done = subprocess.Popen([sys.executable, "-c", script], stderr=theirs, env=environment)
    os.close(theirs)
    text = b""
    while part := _read(ours):
        text += part
    assert done.wait() == 0
    assert b"working" in text
    assert b"\x1b[?25l" in text


def _read(terminal):
    try:
        return os.read(terminal, 4096)
    except OSError:  # the other side is closed
        return b""


@pytest.mark.long
def test_a_notebook_has_a_widget():
    program = (
        "import time\n"
        "from ipywidgets.widgets.widget import _instances\n"
        "from cosim.base.progress import progress_bars\n"
        "with progress_bars() as progress:\n"
        "    progress('working', 1, 2)\n"
        "    while not _instances:\n"  # until the execution's timeout
        "        time.sleep(0.1)\n"
    )
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(program)])
    root = {"metadata": {"path": Path(__file__).parents[3]}}
    for _ in range(2):  # next to other kernels a reply can be lost
        with contextlib.suppress(CellTimeoutError):
            NotebookClient(notebook, resources=root, timeout=120, kernel_name="python3").execute()
            break
    kinds = {kind for output in notebook.cells[0].outputs for kind in output.get("data", {})}
    assert "application/vnd.jupyter.widget-view+json" in kinds


def test_bars_show_names_as_they_are():
    def work(progress, text):
        progress("p[a]/policy.npz [/]", 1, 3, "[b]1/3 :bug:")
        wait_for(text, "[b]1/3 :bug:")

    assert "p[a]/policy.npz [/]" in shown(work, terminal=True)
