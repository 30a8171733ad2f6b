"""Commands in processes of their own: bounded, or to be killed."""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest


class Bounded(NamedTuple):
    """How a command ended, what it said, and the most memory that was ever taken, in bytes."""

    status: int
    stdout: str
    stderr: str
    most_bytes: int


@pytest.fixture(scope="module")
def bounded(tmp_path_factory) -> Iterator[Callable[..., Bounded]]:
    """Runs a command by its name, see `bounded.py`."""
    folder = tmp_path_factory.mktemp("temporary")
    command = [sys.executable, Path(__file__).with_name("bounded.py")]
    how: Any = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    processes: list[subprocess.Popen[str]] = []

    def run(module: str, *arguments: object) -> Bounded:
        if not processes or processes[-1].poll() is not None:
            environment = os.environ | {"TMPDIR": str(folder)}
            processes.append(subprocess.Popen(command, env=environment, **how))
        reader, writer = processes[-1].stdout, processes[-1].stdin
        assert reader is not None
        print(json.dumps([module, *map(str, arguments)]), file=writer, flush=True)
        answer = reader.readline()
        assert answer, f"{module} {arguments} crashed or took too long: {processes[-1].wait()}"
        return Bounded(*json.loads(answer))

    yield run
    for process in processes:
        process.communicate()
    assert list(folder.iterdir()) == []
