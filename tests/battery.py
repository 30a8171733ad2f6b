"""`python -m tests.battery`: all faults, hostile files and long runs, counted.

The tests are those that docs/reliability.md names, section by section; what became of them is read
from the report that pytest writes.
"""

import re
import subprocess
import sys
import tempfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from cosim.base.errors import run_command
from minirobots.runner import parse, print_json

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "reliability.md"
NAME = re.compile(r"`(tests/[\w/]+\.py)::(\w+)`")
MARKS = "not slow and not viewer and not cluster"
# What the tests of a section of the page count.
SECTIONS = {
    "Faults": "faults_survived",
    "Files and command lines": "files_refused",
    "Long runs": "long_runs",
    "Foreign FMUs": "faults_survived",
    "The same again": "same_again",
}


@dataclass(frozen=True, kw_only=True)
class Battery:
    """Run the tests that docs/reliability.md names, and count what was survived and refused.

    Kills, full disks, files of strangers and simulated hours: some fifteen minutes on two cores.
    """

    quick: bool = False
    """Without the tests marked faults."""


def named() -> dict[str, list[tuple[str, str]]]:
    """Files and names of the tests of every section of the page."""
    _, *sections = re.split(r"^## ", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE)
    return {text.partition("\n")[0]: NAME.findall(text) for text in sections}


def count(report: Path) -> dict[str, Any]:
    """What pytest's report says: tests passed by section, hours simulated, tests that failed."""
    tests = {test: SECTIONS[name] for name, some in named().items() for test in some}
    passed: Counter[str] = Counter(dict.fromkeys(SECTIONS.values(), 0))
    hours, lost = 0.0, []
    for case in ElementTree.parse(report).iter("testcase"):
        file = case.get("classname", "").replace(".", "/") + ".py"
        name = case.get("name", "")
        if case.find("failure") is not None or case.find("error") is not None:
            lost.append(f"{file}::{name}")
            continue
        passed[tests[file, name.partition("[")[0]]] += 1
        properties = {p.get("name"): p.get("value", "") for p in case.iter("property")}
        hours += float(properties.get("hours", 0.0))
    return {**passed, "hours_run": round(hours, 3), "lost": lost}


def main() -> None:
    """Command line; see `Battery`."""
    line = parse(Battery, "python -m tests.battery")
    options = line.options
    tests = dict.fromkeys("::".join(test) for some in named().values() for test in some)
    marks = f"{MARKS} and not faults" if options.quick else MARKS
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.xml"
        command = [sys.executable, "-m", "pytest", *tests, "-m", marks, f"--junitxml={report}"]
        subprocess.run(command, cwd=ROOT, check=False, stdout=sys.stderr)
        found = count(report)
    print(f"faults survived: {found['faults_survived']}")
    print(f"files and command lines refused or taken: {found['files_refused']}")
    print(f"long runs: {found['long_runs']}, {found['hours_run']:g} simulated hours")
    print(f"the same again: {found['same_again']}")
    print(f"lost: {', '.join(found['lost']) or 'nothing'}")
    if line.json:
        print_json(found)
    if found["lost"]:
        sys.exit(1)


if __name__ == "__main__":
    run_command(main)
