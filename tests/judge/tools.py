"""The judges, one function each: what one of them says of one FMU.

Importers simulate the experiment of `tests.judge.experiment`; its own results are compared.
"""

import csv
import json
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, NamedTuple

import fmpy
import fmpy.validation
import msgspec
import numpy as np

from cosim.base.errors import UserError
from fmus.models import Fmi, Model
from tests.judge.experiment import INPUTS, OUTPUTS, STEP_S, STOP_S, reference_rows

TIMEOUT_S = 120.0
SAME = 1e-9  # largest deviation that passes; the bits of times need not be the same
_TOLD = 200  # characters of what a tool said


class Artefact(NamedTuple):
    """An FMU that is judged."""

    model: Model
    fmi: Fmi
    path: Path

    @property
    def name(self) -> str:
        """Model and standard."""
        return f"{self.model}, FMI {self.fmi}"


class Verdict(msgspec.Struct, frozen=True):
    """What a judge says of an FMU."""

    tool: str
    version: str  # of the tool, empty if it is not at hand
    artefact: str  # model and standard
    says: str  # "valid", "not at hand: …", or what is wrong
    # Largest of all outputs from the reference results, relative to the largest value of that
    # output; None where nothing was simulated
    deviation: float | None
    agrees: bool | None  # whether the FMU passes; None if no tool was asked


class Tool(NamedTuple):
    """A judge."""

    name: str
    version: str  # empty if it is not at hand
    missing: str  # what to do then
    # Outputs after every step, shape (steps, outputs), or a list of problems of a validator
    judge: Callable[[Artefact], "np.ndarray | list[str]"]
    standards: tuple[Fmi, ...] = ("2", "3")
    models: tuple[Model, ...] = ("VibrationMotor",)

    def takes(self, artefact: Artefact) -> bool:
        """Whether it is asked about an FMU."""
        return artefact.fmi in self.standards and artefact.model in self.models


def ask(tool: Tool, artefact: Artefact) -> Verdict:
    """What a judge says of an FMU; a judge that is not at hand is said to be so."""
    if not tool.version:
        return Verdict(tool.name, "", artefact.name, f"not at hand: {tool.missing}", None, None)
    try:
        found = tool.judge(artefact)
    except (UserError, OSError, ValueError, subprocess.TimeoutExpired) as error:
        return Verdict(tool.name, tool.version, artefact.name, f"failed: {error}", None, False)
    if isinstance(found, list):
        says = "; ".join(found) or "valid"
        return Verdict(tool.name, tool.version, artefact.name, says, None, not found)
    deviation = deviation_of(found)
    says = "the same bits" if deviation == 0.0 else "simulated"
    return Verdict(tool.name, tool.version, artefact.name, says, deviation, deviation <= SAME)


def deviation_of(found: np.ndarray) -> float:
    """Largest deviation of an output, relative to its largest value."""
    expected = reference_rows()
    if found.shape != expected.shape:
        raise ValueError(f"{found.shape[0]} rows of {found.shape[1]} outputs")
    scale = np.abs(expected).max(axis=0)
    return float((np.abs(found - expected) / np.where(scale > 0.0, scale, 1.0)).max())


def package_version(package: str) -> str:
    """Version of a package, empty if it is not installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        return ""


def version_in(path: Path | None) -> str:
    """The version that a program's path names, such as Reference-FMUs-0.0.39/fmusim, if any."""
    numbers = re.findall(r"\d+(?:\.\d+)+", str(path.resolve())) if path else [""]
    return ["unknown", *numbers][-1]


def validate_by_fmpy(artefact: Artefact) -> list[str]:
    """Problems that fmpy's validator finds."""
    return fmpy.validation.validate_fmu(str(artefact.path))


def simulate_by_fmpy(artefact: Artefact) -> np.ndarray:
    """Outputs by `fmpy.simulate_fmu`."""
    how: Any = {"stop_time": STOP_S, "output_interval": STEP_S, "output": OUTPUTS}
    result = fmpy.simulate_fmu(str(artefact.path), start_values=dict(INPUTS), **how)
    return np.array([result[name] for name in OUTPUTS]).T[1:]


def simulate_in_process(importer: str, artefact: Artefact) -> np.ndarray:
    """Outputs by an importer of `tests.judge.importer`."""
    said = run([sys.executable, "-m", "tests.judge.importer", importer, str(artefact.path)])
    return np.array(json.loads(said.splitlines()[-1]))


def simulate_by_fmusim(program: Path | None, artefact: Artefact) -> np.ndarray:
    """Outputs by the fmusim of the Reference FMUs."""
    options = ["--interface-type", "cs", "--stop-time", str(STOP_S)]
    options += ["--output-interval", str(STEP_S)]
    for name, value in INPUTS.items():
        options += ["--start-value", name, repr(value)]
    for name in OUTPUTS:
        options += ["--output-variable", name]
    return _from_file([str(program), *options, "--output-file"], artefact)


def simulate_by_fmucheck(program: Path | None, artefact: Artefact) -> np.ndarray:
    """Outputs by the FMU Compliance Checker; raises ValueError with what it complains about."""
    with tempfile.TemporaryDirectory() as folder:
        inputs = Path(folder) / "in.csv"
        rows = [["time", *INPUTS], *([t, *INPUTS.values()] for t in (0.0, STOP_S))]
        inputs.write_text("".join(",".join(map(str, row)) + "\n" for row in rows))
        options = ["-k", "cs", "-f", "-s", str(STOP_S), "-i", str(inputs)]
        options += ["-h", str(STEP_S), "-n", "0"]
        return _from_file([str(program), *options, "-o"], artefact)


def validate_by_vdmcheck(jar: Path | None, artefact: Artefact) -> list[str]:
    """Problems that VDMCheck finds."""
    said = run(["java", "-jar", str(jar), str(artefact.path)])
    return [] if re.search(r"no errors found", said, re.IGNORECASE) else [said.strip()[-_TOLD:]]


def run(command: Sequence[str]) -> str:
    """What a tool prints; raises ValueError with the end of what it said if it failed."""
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, timeout=TIMEOUT_S, errors="replace"
    )
    if done.returncode:
        said = " ".join((done.stderr + done.stdout).split())
        raise ValueError(f"status {done.returncode}: {said[-_TOLD:]}")
    return done.stdout


def _from_file(command: list[str], artefact: Artefact) -> np.ndarray:
    """Outputs after every step from the CSV file of a command, which ends with it and the FMU."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out.csv"
        run([*command, str(out), str(artefact.path)])
        with out.open(newline="") as file:
            header, *rows = csv.reader(file)
    places = [[name.strip() for name in header].index(output) for output in OUTPUTS]
    return np.array([[float(row[k]) for k in places] for row in rows[1:]])
