"""Write faults into a copy of the code and count those that no test notices.

Mutations are data, `mutations.toml`: a file, a text that occurs once in it, what replaces it, and
the tests that must notice. The working tree stays as it is.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from cosim.base.errors import UserError
from minirobots.options import CommandOptions

ROOT = Path(__file__).parents[2]
COPIED = (
    "fmus", "cosim", "agent", "analysis", "minirobots", "benchmarks", "tests", "docs",
    "pyproject.toml",
)  # fmt: skip
Part = Literal["paper", "motor", "physics", "learning", "steering", "shield"]
PASSED, FAILED = 0, 1  # exit statuses of pytest


@dataclass(frozen=True, kw_only=True)
class Options(CommandOptions):
    """Write faults into a copy of the code, one at a time, and count those that no test notices.

    Their list is benchmarks/reliability/mutations.toml. Run it in a checkout with the group test.
    """

    parts: tuple[Part, ...] = get_args(Part)
    """Parts of the project whose faults are tried, all by default."""


@dataclass(frozen=True)
class Mutation:
    """A fault that is written into the code.

    Attributes:
        part: of the project, such as "motor".
        change: what it changes, as text.
        file: path in the project.
        old, new: a text that occurs once in the file, and what replaces it.
        tests: files or tests that pytest runs.
    """

    part: str
    change: str
    file: str
    old: str
    new: str
    tests: list[str]


def read_mutations() -> list[Mutation]:
    """Return the mutations of `mutations.toml`."""
    content = tomllib.loads(Path(__file__).with_suffix(".toml").read_text())
    return [Mutation(**row) for row in content["mutation"]]


def _first_failure(folder: Path, tests: Iterable[str]) -> str:
    """Run tests in a copy of the project and return the first one that fails, or an empty text."""
    environment = os.environ | {"PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
    options = ["-n", "0", "-x", "-q", "-m", "", "--tb=no", "-rfE", "-p", "no:cacheprovider"]
    run = subprocess.run(
        [sys.executable, "-m", "pytest", *options, *tests],
        cwd=folder, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    if run.returncode == PASSED:
        return ""
    failed = re.search("^(?:FAILED|ERROR) (.*?)(?: - .*)?$", run.stdout, re.MULTILINE)
    if run.returncode != FAILED or failed is None:
        raise UserError(f"pytest {' '.join(tests)} could not run: {run.stdout[-500:]}")
    return failed[1]


def measure(parts: tuple[str, ...]) -> dict[str, Any]:
    """Try the mutations of some parts; without any the tests must pass.

    Part, change and first failing test of each are found; no test where all passed.
    """
    mutations = [m for m in read_mutations() if m.part in parts]
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for name in COPIED:
            copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
            copy(ROOT / name, folder / name)
        tests = sorted({test for mutation in mutations for test in mutation.tests})
        if broken := _first_failure(folder, tests):
            raise UserError(f"{broken} fails without any mutation; fix it first")
        killed_by = []
        for mutation in mutations:
            path = folder / mutation.file
            text = path.read_text()
            if (count := text.count(mutation.old)) != 1:
                raise UserError(f"{mutation.file} has {mutation.old!r} {count} times, not once")
            path.write_text(text.replace(mutation.old, mutation.new))
            killer = _first_failure(folder, mutation.tests)
            path.write_text(text)
            part, change = mutation.part, mutation.change
            killed_by.append({"part": part, "mutation": change, "killed_by": killer})
            print(*killed_by[-1].values(), sep=" | ", file=sys.stderr, flush=True)
    survived = sum(not row["killed_by"] for row in killed_by)
    return {"survived": survived, "tried": len(killed_by), "killed_by": killed_by}
