"""Container FMUs of a system: the FMUs of an archive and a master not written here, as one FMU.

`fmpy` makes them with fmpy.container_fmu, `toolbox` with the fmu-manipulation-toolbox. Outputs of a
container are the robots' poses, named `robot1.x` and so on.
"""

import json
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Literal

import fmpy
import numpy as np
from fmpy.container_fmu.cli import create_container_fmu
from fmpy.container_fmu.config import Component, Configuration, Connection
from fmpy.model_description import CoSimulation, ModelDescription, ModelVariable, Unknown

from fmus.models import Fmi
from fmus.ssp.system import SspSystem, robots_with_motors


def unpacked(archive: Path, folder: Path) -> Path:
    """Folder with the FMUs of an archive."""
    with zipfile.ZipFile(archive) as content:
        content.extractall(folder)
    return folder / "resources"


def pack_with_fmpy(archive: Path, fmi: Fmi, step_s: float, folder: Path) -> Path:
    """A container by fmpy.

    Args:
        archive: of the system, with FMUs of that standard.
        fmi: of the container.
        step_s: communication step within it.
        folder: that receives it.
    """
    system, resources = robots_with_motors(), unpacked(archive, folder / "system")
    parts: dict[str, Component] = {}
    known: dict[str, dict[str, ModelVariable]] = {}
    for name, model, *_ in system.components:
        path = resources / f"{model}.fmu"
        description = fmpy.read_model_description(str(path))
        parts[name] = Component(name, path, description)
        known[name] = {v.name: v for v in description.modelVariables}
        for variable in known[name].values():  # of which it knows the types of FMI 3 alone
            variable.type = "Float64" if variable.type == "Real" else variable.type
    mappings, outputs = {}, []
    kind: Literal["Real", "Float64"] = "Real" if fmi == "2" else "Float64"
    for name, _, values, shown in system.components:
        for variable in (*values, *shown):
            own = known[name][variable]
            parameter = own.causality == "parameter"
            whole = ModelVariable(
                name=f"{name}.{variable}",
                type=kind,
                causality=own.causality,
                variability="fixed" if parameter else "continuous",
                initial="exact" if parameter else None,
                start=repr(values[variable]) if variable in values else None,
            )
            mappings[whole] = [(parts[name], own)]
            if variable in shown:
                outputs.append(Unknown(variable=whole))
    # The container counts its variables from the time, which belongs to no component.
    time = ModelVariable("time", type=kind, causality="independent", variability="continuous")
    description = ModelDescription(
        fmiVersion=f"{fmi}.0",
        modelName=system.name,
        instantiationToken=f"{{{system.name}}}",
        coSimulation=CoSimulation("container_fmu", fixedInternalStepSize=step_s),
        modelVariables=[time, *mappings],
        outputs=outputs,
    )
    connections = [
        Connection(parts[start], [known[start][output]], parts[end], [known[end][entry]])
        for start, output, end, entry in system.connections
    ]
    work, made = folder / "work", folder / f"fmpy_fmi{fmi}.fmu"
    work.mkdir()
    configuration = Configuration(False, description, list(parts.values()), connections, mappings)
    create_container_fmu(configuration, work, made)
    return made


def pack_with_toolbox(
    archive: Path, fmi: Fmi, step_s: float, folder: Path, *, sequential: bool = False
) -> Path:
    """Pack by fmu-manipulation-toolbox; `sequential`: one component steps after the other."""
    system = robots_with_motors(motors_first=sequential)
    resources = unpacked(archive, folder / "system")
    made = resources / f"toolbox_fmi{fmi}{'_sequential' * sequential}.fmu"
    description = made.with_suffix(".json")
    description.write_text(json.dumps(_toolbox_json(system, step_s, made.name, sequential)))
    line = [sys.executable, "-m", "fmu_manipulation_toolbox.cli.fmucontainer"]
    line += ["-container", description.name, "-fmi", fmi, "-fmu-directory", str(resources)]
    subprocess.run(line, cwd=resources, capture_output=True, text=True, check=True)
    return made


def _toolbox_json(system: SspSystem, step_s: float, name: str, sequential: bool) -> dict:
    parts = [(f"{component.name}.fmu", component) for component in system.components]
    return {
        "name": name,
        "step_size": step_s,
        "sequential": sequential,
        **dict.fromkeys(("auto_input", "auto_output", "auto_link", "auto_parameter"), False),
        "fmu": [part for part, _ in parts],
        "path": {part: f"{component.model}.fmu" for part, component in parts},
        "link": [[f"{c.start}.fmu", c.output, f"{c.end}.fmu", c.input] for c in system.connections],
        "start": [[part, *value] for part, c in parts for value in c.values.items()],
        "output": [[part, name, f"{c.name}.{name}"] for part, c in parts for name in c.shown],
    }


def simulate(path: Path, duration_s: float, period_s: float) -> np.ndarray:
    """Poses (n, robots, 7) after every period, of a container in fmpy."""
    robots = [c for c in robots_with_motors().components if c.shown]
    names = [f"{c.name}.{variable}" for c in robots for variable in c.shown]
    found = fmpy.simulate_fmu(
        str(path), stop_time=duration_s, output_interval=period_s, output=names
    )
    rows = np.array([found[name] for name in names]).T[1:]
    return np.ascontiguousarray(rows.reshape(len(rows), len(robots), -1))
