"""The two coupled masses in masters not written here, each in a process of its own.

Both masses begin at 1 m, as the FMUs do alone: libcosim sets no start values of outputs.

`python -m tests.references.masses_ssp NAME ARCHIVE STEP_S UNTIL_S` prints the places of both masses
at the end in m, and the wall-clock time of a step in ns, as JSON.
"""

import json
import subprocess
import sys
import time
import zipfile
from pathlib import Path
from typing import NamedTuple

from tests.judge.importer import link_ecospy
from tests.references.two_masses import CONNECTIONS, two_masses

_SSD = """<?xml version="1.0" encoding="UTF-8"?>
<ssd:SystemStructureDescription version="1.0" name="masses"
  xmlns:ssd="http://ssp-standard.org/SSP1/SystemStructureDescription"
  xmlns:ssc="http://ssp-standard.org/SSP1/SystemStructureCommon"
  xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues"
  xmlns:ssb="http://ssp-standard.org/SSP1/SystemStructureSignalDictionary">
<ssd:System name="masses">
<ssd:Elements>{components}</ssd:Elements><ssd:Connections>{connections}</ssd:Connections>
</ssd:System>
<ssd:DefaultExperiment startTime="0" stopTime="1"/></ssd:SystemStructureDescription>"""
_VALUES = """<ssd:ParameterBindings><ssd:ParameterBinding><ssd:ParameterValues>
<ssv:ParameterSet version="1.0" name="initialValues"><ssv:Parameters>{}</ssv:Parameters>
</ssv:ParameterSet></ssd:ParameterValues></ssd:ParameterBinding></ssd:ParameterBindings>"""


class EndOfRun(NamedTuple):
    """Where both masses are at the end in m, and the time of a step in ns."""

    places_m: list[float]
    ns: float


def write_archive(folder: Path) -> Path:
    """Write the masses as an archive of SSP 1.0 with FMUs of FMI 2.0."""
    components = ""
    path = folder / "masses.ssp"
    with zipfile.ZipFile(path, "w") as archive:
        for component in two_masses(folder, (2, 2)):
            name, fmu = component.name, component.fmu
            assert not isinstance(fmu, Path)
            archive.write(fmu.path, f"resources/{name}.fmu")
            ends = [end for c in CONNECTIONS for end in (c.source, c.target)]
            own = [end.partition(".")[2] for end in ends if end.startswith(f"{name}.")]
            kinds = {v: "input" if "_in" in v else "output" for v in (*own, "x")}
            connectors = "".join(
                f'<ssd:Connector name="{v}" kind="{kind}"><ssc:Real/></ssd:Connector>'
                for v, kind in kinds.items()
            )
            given = {v: value for v, value in component.start.items() if v != "x"}
            connectors += "".join(
                f'<ssd:Connector name="{v}" kind="parameter"><ssc:Real/></ssd:Connector>'
                for v in given
            )
            values = "".join(
                f'<ssv:Parameter name="{v}"><ssv:Real value="{value}"/></ssv:Parameter>'
                for v, value in given.items()
            )
            components += (
                f'<ssd:Component name="{name}" type="application/x-fmu-sharedlibrary" '
                f'source="resources/{name}.fmu"><ssd:Connectors>{connectors}</ssd:Connectors>'
                f"{_VALUES.format(values)}</ssd:Component>"
            )
        connections = "".join(
            '<ssd:Connection startElement="{}" startConnector="{}" endElement="{}" '
            'endConnector="{}"/>'.format(*c.source.split("."), *c.target.split("."))
            for c in CONNECTIONS
        )
        archive.writestr(
            "SystemStructure.ssd", _SSD.format(components=components, connections=connections)
        )
    return path


def run_ecospy(archive: str, step_s: float, steps: int) -> EndOfRun:
    link_ecospy()
    from ecospy import EcosSimulation

    with EcosSimulation(step_size=step_s, ssp_path=archive) as simulation:
        simulation.init(parameter_set="initialValues")
        begin = time.perf_counter_ns()
        simulation.step(steps)
        ns = (time.perf_counter_ns() - begin) / steps
        return EndOfRun([simulation.get_real(f"{m}::x") for m in ("first", "second")], ns)


def run_libcosimpy(archive: str, step_s: float, steps: int) -> EndOfRun:
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimObserver import CosimObserver

    execution = CosimExecution.from_ssp_file(archive, round(step_s * 1e9))
    observer = CosimObserver.create_last_value()
    execution.add_observer(observer)
    begin = time.perf_counter_ns()
    execution.step(steps)
    ns = (time.perf_counter_ns() - begin) / steps
    places = []
    for mass in ("first", "second"):
        index = execution.slave_index_from_instance_name(mass)
        assert index is not None
        references = {v.name.decode(): v.reference for v in execution.slave_variables(index)}
        places += observer.last_real_values(index, [references["x"]])
    return EndOfRun(places, ns)


MASTERS = {"ecospy": run_ecospy, "libcosimpy": run_libcosimpy}


def run(name: str, archive: Path, step_s: float, steps: int) -> EndOfRun:
    """Run a master in a process of its own.

    Raises:
        RuntimeError: it failed; with what it said last.
    """
    line = [sys.executable, "-m", __name__, name, str(archive), str(step_s), str(steps)]
    done = subprocess.run(line, capture_output=True, text=True, check=False, timeout=600)
    if done.returncode:
        raise RuntimeError(f"{name} failed: {done.stderr.strip()[-2000:]}")
    return EndOfRun(*json.loads(done.stdout.splitlines()[-1]))


if __name__ == "__main__":
    print(json.dumps(MASTERS[sys.argv[1]](sys.argv[2], float(sys.argv[3]), int(sys.argv[4]))))
