"""The Modelica Association's reference FMUs in our master, against the outputs that they publish.

Their sources come from a copy of https://github.com/modelica/Reference-FMUs. Every model is
compiled for this machine, as FMI 2.0 where there is such a description and as FMI 3.0, and run over
the times of its published output. Those outputs come from Euler's method with the models' fixed
steps, as the FMUs for Co-Simulation have it; for Model Exchange the reference is fmpy's simulation
of the same FMU. Stair's steps and Van der Pol's place are passed on through Feedthrough, too, from
one standard to the other.
"""

import csv
import itertools
import tempfile
import zipfile
from collections.abc import Iterable
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
Outputs = dict[str, np.ndarray]


class Options(CommandOptions):
    src: Folder
    """Copy of https://github.com/modelica/Reference-FMUs."""


def build(source: Path, folder: Path) -> dict[tuple[str, int], Path]:
    """FMUs in a folder, by model and standard."""
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


def published(path: Path) -> tuple[np.ndarray, Outputs]:
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


def measure(options: Options) -> dict[str, Any]:
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        fmus = build(options.src, Path(folder))
        outputs = {m: published(options.src / m / f"{m}_out.csv") for m in MODELS}
        for (model, fmi), path in fmus.items():
            modes = (False, True) if (model, fmi) == ("BouncingBall", 3) else (False,)
            row = {"model": model, "fmi": fmi}
            rows += [row | _compared(path, model, *outputs[model], events) for events in modes]
        for (model, fmi), path in fmus.items():
            row = {"model": model, "fmi": fmi}
            rows.append(row | _exchanged(path, model, *outputs[model]))
        passed = [
            _passed_on(fmus, source, target, exchange)
            for source, target, exchange in itertools.product((2, 3), (2, 3), (False, True))
        ]
    return {"models": rows, "passed_on": passed}


def _compared(
    path: Path, model: str, time_s: np.ndarray, expected: Outputs, events: bool
) -> dict[str, Any]:
    """Deviations of a model for Co-Simulation from what is published."""
    found, expected, ended = _run(Fmu(path), model, time_s, expected, events)
    return {
        "event_mode": events,
        "rows": len(time_s),
        "variables": len(expected),
        "largest": max(float(np.abs(values).max()) for values in expected.values()),
        "deviation": _apart(found, expected, len(time_s)),
        "ended": ended,
    }


def _exchanged(path: Path, model: str, time_s: np.ndarray, expected: Outputs) -> dict[str, Any]:
    """Deviations of a model for Model Exchange: from what is published, and from fmpy's solver."""
    found, expected, ended = _run(Fmu(path, exchange=True), model, time_s, expected)
    step_s, until_s = _times(time_s)
    other = simulate_fmu(
        str(path), stop_time=until_s, fmi_type="ModelExchange", relative_tolerance=1e-10,
        output=list(expected), output_interval=step_s, record_events=False,
    )  # fmt: skip
    rows = min(len(time_s), len(other))  # where one has ended, fmpy has no last row
    return {
        "exchange": True,
        "rows": len(time_s),
        "deviation": _apart(found, expected, rows),
        "from_fmpy": _apart(found, other, rows, expected),
        "published_from_fmpy": _apart(expected, other, rows, expected),
        "ended": ended,
    }


def _run(
    fmu: Fmu, model: str, time_s: np.ndarray, expected: Outputs, events: bool = False
) -> tuple[Outputs, Outputs, Any]:
    """Run a model: its outputs, those that are expected and it has, and why it ended if it did."""
    # FMI 2.0 has fewer types
    expected = {name: values for name, values in expected.items() if name in fmu.variables}
    step_s, until_s = _times(time_s)
    names = {name: f"{model}.{name}" for name in expected}
    settings = {"step_s": step_s, "record": [*names.values()], "event_mode": events}
    with System([Component(model, fmu)], **settings) as system:
        run = system.run(until_s)
    found = {name: run.signals[full].astype(float) for name, full in names.items()}
    return found, expected, run.ended


def _times(time_s: np.ndarray) -> tuple[float, float]:
    """Step and end of a run over these times, in s."""
    step_s = round(float(time_s[1] - time_s[0]), 9)
    return step_s, round(float(time_s[-1]) / step_s) * step_s


def _apart(a: Any, b: Any, rows: int, names: Iterable[str] = ()) -> float:
    """Largest difference of the first rows of some columns, by default of all of the first."""
    return max(float(np.abs(a[name][:rows] - b[name][:rows]).max()) for name in names or a)


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
