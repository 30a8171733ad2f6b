"""Simulate an FMU's experiment in an importer not written here; a process of its own for each.

`python -m tests.judge.importer {ecospy,libcosimpy} FMU` prints the outputs after every step as
JSON. Both importers come from the package registry (group `test`).
"""

import ctypes
import json
import sys
from pathlib import Path

from tests.judge.experiment import INPUTS, OUTPUTS, STEP_S, STEPS


def run_ecospy(fmu: str) -> list[list[float]]:
    """Rows of outputs, by ecospy."""
    # It links to PyPI's tbb without saying where.
    ctypes.CDLL(str(Path(sys.prefix) / "lib" / "libtbb.so.12"), mode=ctypes.RTLD_GLOBAL)
    from ecospy import EcosSimulation, EcosSimulationStructure

    with EcosSimulationStructure() as structure:
        structure.add_model("fmu", fmu)
        start = {f"fmu::{name}": value for name, value in INPUTS.items()}
        structure.add_parameter_set("start", start)
        with EcosSimulation(structure=structure, step_size=STEP_S) as simulation:
            simulation.init(parameter_set="start")
            rows = []
            for _ in range(STEPS):
                simulation.step()
                rows.append([simulation.get_real(f"fmu::{name}") for name in OUTPUTS])
            return rows


def run_libcosimpy(fmu: str) -> list[list[float]]:
    """Rows of outputs, by libcosimpy."""
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimObserver import CosimObserver
    from libcosimpy.CosimSlave import CosimLocalSlave

    execution = CosimExecution.from_step_size(round(STEP_S * 1e9))
    index = execution.add_local_slave(CosimLocalSlave(fmu, "fmu"))
    references = {v.name.decode(): v.reference for v in execution.slave_variables(index)}
    for name, value in INPUTS.items():
        execution.real_initial_value(index, references[name], value)
    observer = CosimObserver.create_last_value()
    execution.add_observer(observer)
    rows = []
    for _ in range(STEPS):
        assert execution.step(1)
        rows.append(list(observer.last_real_values(index, [references[n] for n in OUTPUTS])))
    return rows


if __name__ == "__main__":
    run = {"ecospy": run_ecospy, "libcosimpy": run_libcosimpy}[sys.argv[1]]
    print("\n" + json.dumps(run(sys.argv[2])))
