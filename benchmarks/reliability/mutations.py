"""Write faults into a copy of the code, one at a time, and count those that no test notices.

Mutations are data, benchmarks/reliability/mutations.toml: the part of the project, what changes as
text, a file, a text that occurs once in it (old), what replaces it (new), and the tests that must
notice. The working tree, a checkout with the group test, stays as it is.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterable
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


class Options(CommandOptions):
    parts: tuple[Part, ...] = get_args(Part)
    """Parts of the project with faults to try, all by default."""


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


def measure(options: Options) -> dict[str, Any]:
    """Try the mutations of some parts; without any the tests must pass.

    Part, change and first failing test of each are found; no test where all passed.
    """
    content = tomllib.loads(Path(__file__).with_suffix(".toml").read_text())
    mutations = [m for m in content["mutation"] if m["part"] in options.parts]
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for name in COPIED:
            copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
            copy(ROOT / name, folder / name)
        tests = sorted({test for mutation in mutations for test in mutation["tests"]})
        if broken := _first_failure(folder, tests):
            raise UserError(f"{broken} fails without any mutation; fix it first")
        killed_by = []
        for mutation in mutations:
            path, old = folder / mutation["file"], mutation["old"]
            text = path.read_text()
            if (count := text.count(old)) != 1:
                raise UserError(f"{mutation['file']} has {old!r} {count} times, not once")
            path.write_text(text.replace(old, mutation["new"]))
            killer = _first_failure(folder, mutation["tests"])
            path.write_text(text)
            row = {"part": mutation["part"], "mutation": mutation["change"]}
            killed_by.append(row | {"killed_by": killer})
            print(*killed_by[-1].values(), sep=" | ", file=sys.stderr, flush=True)
    survived = sum(not row["killed_by"] for row in killed_by)
    return {"survived": survived, "tried": len(killed_by), "killed_by": killed_by}
