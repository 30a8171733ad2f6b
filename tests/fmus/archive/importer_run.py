"""Runs the motor FMU for 1 s in an importer not written here; a process of its own for each.

`python importer_run.py {ecospy,libcosimpy} FMU` prints omega at every millisecond as JSON.
"""

import ctypes
import json
import sys
from pathlib import Path

STEPS, STEP_S, SET_POINT = 1000, 1e-3, 700.0


def run_ecospy(fmu: str) -> list[float]:
    # ecospy links to tbb without saying where; PyPI's tbb lies in the environment's lib folder.
    ctypes.CDLL(str(Path(sys.prefix) / "lib" / "libtbb.so.12"), mode=ctypes.RTLD_GLOBAL)
    from ecospy import EcosSimulation, EcosSimulationStructure

    with EcosSimulationStructure() as structure:
        structure.add_model("motor", fmu)
        structure.add_parameter_set("start", {"motor::omega_des": SET_POINT})
        with EcosSimulation(structure=structure, step_size=STEP_S) as simulation:
            simulation.init(parameter_set="start")
            speeds = []
            for _ in range(STEPS):
                simulation.step()
                speeds.append(simulation.get_real("motor::omega"))
            return speeds


def run_libcosimpy(fmu: str) -> list[float]:
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimObserver import CosimObserver
    from libcosimpy.CosimSlave import CosimLocalSlave

    execution = CosimExecution.from_step_size(round(STEP_S * 1e9))
    index = execution.add_local_slave(CosimLocalSlave(fmu, "motor"))
    references = {v.name.decode(): v.reference for v in execution.slave_variables(index)}
    execution.real_initial_value(index, references["omega_des"], SET_POINT)
    observer = CosimObserver.create_last_value()
    execution.add_observer(observer)
    speeds = []
    for _ in range(STEPS):
        assert execution.step(1)
        speeds.append(observer.last_real_values(index, [references["omega"]])[0])
    return speeds


if __name__ == "__main__":
    run = {"ecospy": run_ecospy, "libcosimpy": run_libcosimpy}[sys.argv[1]]
    print("\n" + json.dumps(run(sys.argv[2])))
