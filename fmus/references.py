"""Reference results inside the FMUs, by which an importer can check itself.

`python -m fmus.references` makes them anew, with a loop of its own over the functions of the FMI 3
FMU; they lie beside the sources. In an archive they have the form of the cross-check (`_in.csv`,
`_ref.csv` and `_ref.opt`), and a manifest of the layered standard FMI-LS-REF (1.0.0-alpha.1) says
what each file is.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

from cosim.base.command import Json, parse, print_json
from cosim.base.errors import run_command
from cosim.base.storage import replacing, temporary_folder
from fmus.description import to_bytes
from fmus.models import ROOT, Model, find, folders, read_bytes
from fmus.variables import load_table

FOLDER = "extra/org.fmi-standard.fmi-ls-ref"
_NAMESPACE = "http://fmi-standard.org/fmi-ls-manifest"
_STANDARD = {
    "name": "org.fmi-standard.fmi-ls-ref",
    "version": "1.0.0-alpha.1",
    "description": "Layered Standard providing information on related files included in an FMU.",
}


class ReferenceRun(NamedTuple):
    """Settings of a reference simulation of an FMU.

    Attributes:
        inputs: constant, by name; all others keep their start values.
        stop_s: time at the end; it begins at 0.
        step_s: communication step, and time between rows of the results.
    """

    inputs: dict[str, float]
    stop_s: float
    step_s: float

    @property
    def steps(self) -> int:
        """Number of communication steps."""
        return round(self.stop_s / self.step_s)


# A motor that starts, saturates and settles under a torque. Inputs are constant: importers differ in how they take inputs that change.
EXPERIMENTS: dict[Model, ReferenceRun] = {
    "VibrationMotor": ReferenceRun({"omega_des": 700.0, "d": 1e-6}, 0.5, 5e-3),
}


def outputs_of(model: Model) -> list[str]:
    """Names of a model's outputs, in their order."""
    return [variable.name for variable in load_table(model).group("output")]


def simulate(fmu: Path, model: Model) -> list[list[float]]:
    """The outputs of an FMI 3.0 FMU in its experiment.

    Args:
        fmu: file.
        model: what it is of.

    Returns:
        The time and the outputs, at the start and after every step.
    """
    # here, because building needs neither
    import fmpy  # noqa: PLC0415
    from fmpy.fmi3 import FMU3Slave  # noqa: PLC0415

    experiment, table = EXPERIMENTS[model], load_table(model)
    references = [variable.reference for variable in table.group("output")]
    with temporary_folder() as folder:
        description = fmpy.read_model_description(str(fmu))
        fmpy.extract(str(fmu), folder)
        instance = FMU3Slave(
            guid=description.guid,
            unzipDirectory=folder,
            modelIdentifier=model,
            instanceName="reference",
        )
        instance.instantiate()
        for name, value in experiment.inputs.items():
            instance.setFloat64([table[name].reference], [value])
        instance.enterInitializationMode()
        instance.exitInitializationMode()
        rows = [[0.0, *instance.getFloat64(references)]]
        for k in range(experiment.steps):
            instance.doStep(k * experiment.step_s, experiment.step_s)
            time_s = (k + 1) * experiment.step_s
            rows.append([time_s, *instance.getFloat64(references)])
        instance.terminate()
        instance.freeInstance()
    return rows


def reference_files(model: Model) -> dict[str, bytes]:
    """Return the reference files of a model's archive by name; none if there is no experiment."""
    if model not in EXPERIMENTS:
        return {}
    experiment = EXPERIMENTS[model]
    options = {"StartTime": 0.0, "StopTime": experiment.stop_s, "StepSize": experiment.step_s}
    inputs = [[time_s, *experiment.inputs.values()] for time_s in (0.0, experiment.stop_s)]
    files = {
        f"{model}_in.csv": _csv(["time", *experiment.inputs], inputs),
        f"{model}_ref.csv": read_bytes(model, f"{model}_ref.csv"),
        f"{model}_ref.opt": "".join(f"{k}, {v!r}\n" for k, v in options.items()).encode(),
    }
    related = [
        ("text/csv", f"{model}_in.csv", "testcase", "inputs, by time in s"),
        ("text/csv", f"{model}_ref.csv", "result", "outputs of the co-simulation for these inputs"),
        ("text/plain", f"{model}_ref.opt", "configuration", "start, stop and communication step"),
        ("text/html", "../../documentation/index.html", "document", "equations and variables"),
    ]
    if (modelica := find(model, f"{model}.mo")) is not None:
        files[modelica.name] = modelica.read_bytes()
        related.append(("text/modelica", modelica.name, "model", "readable specification"))
    root = ET.Element("fmiReferences", {"xmlns:fmi-ls": _NAMESPACE} | {
        f"fmi-ls:fmi-ls-{name}": value for name, value in _STANDARD.items()
    })  # fmt: skip
    for kind, source, role, description in related:
        entry = {"type": kind, "source": source, "role": role, "description": description}
        ET.SubElement(root, "Related", entry)
    files["fmi-ls-manifest.xml"] = to_bytes(root)
    return {f"{FOLDER}/{name}": content for name, content in files.items()} | {
        "documentation/fmi-ls-ref.txt": _NOTE.format(model=model).encode()
    }


_NOTE = """\
{model}_in.csv, {model}_ref.csv and {model}_ref.opt in extra/org.fmi-standard.fmi-ls-ref are a smoke
test: inputs, options, and the outputs of the co-simulation interface at every communication step.
With the same communication step an importer gets these numbers on every platform, to the last digit
where it adds up no time by itself. Inputs are constant, and set before initialisation.
"""


def _csv(names: list[str], rows: Sequence[Sequence[float]]) -> bytes:
    lines = [",".join(names), *(",".join(map(repr, row)) for row in rows)]
    return ("\n".join(lines) + "\n").encode()


@dataclass(frozen=True)
class MakeReferences:
    """Make the reference results anew that the FMUs of motor and robot hold."""

    json: Json = False


def main() -> None:
    """Command line; see `MakeReferences`."""
    options = parse(MakeReferences, "fmus.references")
    from fmus.build import build_fmu  # noqa: PLC0415 - which needs references itself

    files = []
    for model in EXPERIMENTS:
        path = folders(model)[0] / f"{model}_ref.csv"
        if not path.exists():  # the first one: an archive holds what is there
            path.write_bytes(b"")
        with temporary_folder() as folder:
            rows = simulate(build_fmu(Path(folder), model), model)
        with replacing(path) as temporary:
            temporary.write_bytes(_csv(["time", *outputs_of(model)], rows))
        files.append(str(path.relative_to(ROOT.parent)))
        print(f"wrote {files[-1]}")
    if options.json:
        print_json({"files": files})


if __name__ == "__main__":
    run_command(main)
