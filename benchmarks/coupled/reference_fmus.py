"""The Modelica Association's reference FMUs in our master, against the outputs that they publish.

Their sources come from a folder of the user's: a copy of
https://github.com/modelica/Reference-FMUs. Every model is compiled for this machine, as FMI 2.0
where there is such a description and as FMI 3.0, and run over the times of its published output.
Those outputs come from Euler's method with the models' fixed steps, as the FMUs for Co-Simulation
have it; for Model Exchange the reference is fmpy's simulation of the same FMU. Stair's steps and
Van der Pol's place are passed on through Feedthrough, too, from one standard to the other.
"""

import csv
import itertools
import tempfile
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from fmpy import platform, platform_tuple, sharedLibraryExtension, simulate_fmu

from cosim.base.errors import UserError
from cosim.fmi.fmu import Fmu
from cosim.system.graph import Component, Connection
from cosim.system.system import System
from minirobots.options import CommandOptions, Folder
from tests.references.small import compile_c

MODELS = ("BouncingBall", "Dahlquist", "Feedthrough", "Stair", "StateSpace", "VanDerPol")
_FLAGS = ("-std=gnu99", "-O2", "-shared", "-fPIC", "-fvisibility=hidden", "-DDISABLE_PREFIX")
_TRUTHS = {"true": 1.0, "false": 0.0}


@dataclass(frozen=True, kw_only=True)
class Options(CommandOptions):
    """Run the reference FMUs of the Modelica Association to the outputs that they publish."""

    src: Folder
    """Copy of https://github.com/modelica/Reference-FMUs."""


def build(source: Path, folder: Path) -> dict[tuple[str, int], Path]:
    """FMUs in a folder, by model and standard.

    Raises:
        UserError: the source folder lacks a model.
        BuildError: the compiler fails.
    """
    found = {}
    for model in MODELS:
        if not (source / model / "model.c").is_file():
            raise UserError(
                f"--src {source}: it has no {model}/model.c; name a copy of "
                "https://github.com/modelica/Reference-FMUs"
            )
        for fmi in (2, 3):
            description = source / model / f"FMI{fmi}.xml"
            if description.is_file():
                found[model, fmi] = _pack(source, folder, model, fmi, description)
    return found


def _pack(source: Path, folder: Path, model: str, fmi: int, description: Path) -> Path:
    names = (f"src/fmi{fmi}Functions.c", "src/cosimulation.c", f"{model}/model.c")
    folders = (source / "include", source / model)
    library = compile_c(
        [source / name for name in names], folders, (*_FLAGS, f"-DFMI_VERSION={fmi}")
    )
    path = folder / f"{model}{fmi}.fmu"
    place = platform if fmi == 2 else platform_tuple
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.write(description, "modelDescription.xml")
        archive.writestr(f"binaries/{place}/{model}{sharedLibraryExtension}", library)
    return path


def published(path: Path) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Times (n,) in s and values (n, …) by name of a file of outputs; texts are left out."""
    with path.open(encoding="utf-8", newline="") as file:
        header, *rows = list(csv.reader(file))
    found = {}
    for name, *texts in zip(header, *rows, strict=True):
        if not name.startswith(("String", "Binary")):
            values = np.array([[_number(each) for each in text.split()] for text in texts])
            found[name] = values[:, 0] if values.shape[1] == 1 else values
    return found.pop(header[0]), found


def _number(text: str) -> float:
    return _TRUTHS[text] if text in _TRUTHS else float(text)


def measure(src: Path) -> dict[str, Any]:
    """Largest deviations from what is published, by model and standard."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        fmus = build(src, Path(folder))
        for (model, fmi), path in fmus.items():
            time_s, expected = published(src / model / f"{model}_out.csv")
            modes = (False, True) if (model, fmi) == ("BouncingBall", 3) else (False,)
            rows += [_compared(model, fmi, path, time_s, expected, events) for events in modes]
        rows += [
            _exchanged(model, fmi, path, *published(src / model / f"{model}_out.csv"))
            for (model, fmi), path in fmus.items()
        ]
        passed = [
            _passed_on(fmus, source, target, exchange)
            for source, target, exchange in itertools.product((2, 3), (2, 3), (False, True))
        ]
    return {"models": rows, "passed_on": passed}


def _compared(
    model: str,
    fmi: int,
    path: Path,
    time_s: np.ndarray,
    expected: dict[str, np.ndarray],
    events: bool,
) -> dict[str, Any]:
    known = Fmu(path).variables  # FMI 2.0 has fewer types
    expected = {name: values for name, values in expected.items() if name in known}
    names = [f"{model}.{name}" for name in expected]
    step_s = round(float(time_s[1] - time_s[0]), 9)
    component = Component(model, path)
    with System([component], step_s=step_s, record=names, event_mode=events) as system:
        until_s = round(float(time_s[-1]) / step_s) * step_s
        run = system.run(until_s)
    found = {name: run.signals[f"{model}.{name}"].astype(float) for name in expected}
    return {
        "model": model,
        "fmi": fmi,
        "event_mode": events,
        "rows": len(time_s),
        "variables": len(expected),
        "largest": max(float(np.abs(values).max()) for values in expected.values()),
        "deviation": max(float(np.abs(found[n] - values).max()) for n, values in expected.items()),
        "ended": run.ended,
    }


def _exchanged(
    model: str, fmi: int, path: Path, time_s: np.ndarray, expected: dict[str, np.ndarray]
) -> dict[str, Any]:
    """Deviations of a model for Model Exchange: from what is published, and from fmpy's solver."""
    fmu = Fmu(path, exchange=True)
    expected = {name: values for name, values in expected.items() if name in fmu.variables}
    step_s = round(float(time_s[1] - time_s[0]), 9)
    until_s = round(float(time_s[-1]) / step_s) * step_s
    names = [f"{model}.{name}" for name in expected]
    with System([Component(model, fmu)], step_s=step_s, record=names) as system:
        run = system.run(until_s)
    other = simulate_fmu(
        str(path), stop_time=until_s, fmi_type="ModelExchange", relative_tolerance=1e-10,
        output=list(expected), output_interval=step_s, record_events=False,
    )  # fmt: skip
    found = {name: run.signals[f"{model}.{name}"].astype(float) for name in expected}
    rows = min(len(time_s), len(other))  # where one has ended, fmpy has no last row

    def largest(a: Any, b: Any) -> float:
        return max(float(np.abs(a[name][:rows] - b[name][:rows]).max()) for name in expected)

    return {
        "model": model,
        "fmi": fmi,
        "exchange": True,
        "rows": len(time_s),
        "deviation": largest(found, expected),
        "from_fmpy": largest(found, other),
        "published_from_fmpy": largest(expected, other),
        "ended": run.ended,
    }


def _passed_on(
    fmus: dict[tuple[str, int], Path], source: int, target: int, exchange: bool
) -> dict[str, Any]:
    """Return whether Feedthrough puts out what Stair and Van der Pol put out, a step later."""
    components = [
        Component("stair", Fmu(fmus["Stair", source], exchange=exchange)),
        Component("van_der_pol", Fmu(fmus["VanDerPol", source], exchange=exchange)),
        Component("through", fmus["Feedthrough", target]),
    ]
    pairs = {"stair.counter": "Int32", "van_der_pol.x0": "Float64_continuous"}
    connections = [Connection(name, f"through.{to}_input") for name, to in pairs.items()]
    with System(components, connections, step_s=0.2) as system:
        run = system.run(8.0)
    same = all(
        (run.signals[f"through.{to}_output"][1:] == run.signals[name][:-1]).all()
        for name, to in pairs.items()
    )
    return {"from_fmi": source, "exchange": exchange, "to_fmi": target, "same": same}
