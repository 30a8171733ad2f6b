"""Masters not written here on an archive of the pair, each in a process of its own.

`python -m tests.references.importers NAME ARCHIVE STEP_S DURATION_S OUT` writes poses
(n, robots, 7) after every millisecond as .npy.
"""

import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from fmus.ssp.system import POSE
from tests.judge.importer import link_ecospy

PERIOD_S = 1e-3
ROBOTS = ("robot1", "robot2")


def run_fmpy(archive: str, step_s: float, duration_s: float) -> np.ndarray:
    from fmpy.ssp.simulation import simulate_ssp
    from fmpy.ssp.ssd import read_ssv

    rows = simulate_ssp(
        archive,
        stop_time=duration_s - 0.5 * step_s,
        step_size=step_s,
        parameter_set=read_ssv(archive, "resources/parameters.ssv"),
    )
    every = round(PERIOD_S / step_s)
    return np.array(
        [[[row[f"{r}.{v}"] for v in POSE] for r in ROBOTS] for row in rows[every - 1 :: every]]
    )


def run_ecospy(archive: str, step_s: float, duration_s: float) -> np.ndarray:
    link_ecospy()
    from ecospy import EcosSimulation

    with EcosSimulation(step_size=step_s, ssp_path=archive) as simulation:
        simulation.init(parameter_set="initialValues")

        def read() -> list[list[float]]:
            return [[simulation.get_real(f"{r}::{v}") for v in POSE] for r in ROBOTS]

        return _poses(simulation.step, read, step_s, duration_s)


def run_libcosimpy(archive: str, step_s: float, duration_s: float) -> np.ndarray:
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimObserver import CosimObserver

    execution = CosimExecution.from_ssp_file(archive, round(step_s * 1e9))
    observer = CosimObserver.create_last_value()
    execution.add_observer(observer)
    places = []
    for robot in ROBOTS:
        index = execution.slave_index_from_instance_name(robot)
        assert index is not None
        references = {v.name.decode(): v.reference for v in execution.slave_variables(index)}
        places.append((index, [references[v] for v in POSE]))
    return _poses(
        execution.step,
        lambda: [observer.last_real_values(*place) for place in places],
        step_s,
        duration_s,
    )


def _poses(
    step: Callable[[int], object],
    read: Callable[[], list],
    step_s: float,
    duration_s: float,
) -> np.ndarray:
    every, found = round(PERIOD_S / step_s), []
    for _ in range(round(duration_s / PERIOD_S)):
        step(every)
        found.append(read())
    return np.array(found)


IMPORTERS = {"fmpy": run_fmpy, "ecospy": run_ecospy, "libcosimpy": run_libcosimpy}


def run(name: str, archive: Path, step_s: float, duration_s: float) -> np.ndarray:
    """Poses by an importer, in a process of its own; archives are of SSP 1.0.

    Raises:
        RuntimeError: it failed; with what it said last.
    """
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "poses.npy"
        line = [sys.executable, "-m", __name__, name, archive, step_s, duration_s, out]
        done = subprocess.run(
            list(map(str, line)), capture_output=True, text=True, check=False, timeout=600
        )
        if done.returncode:
            raise RuntimeError(f"{name} failed: {done.stderr.strip()[-2000:]}")
        return np.load(out)


def relabelled(archive: Path, out: Path) -> Path:
    """An archive of SSP 2.0 as one of SSP 1.0 with FMUs of FMI 3.0, which ecospy reads."""
    with zipfile.ZipFile(archive) as content, zipfile.ZipFile(out, "w") as other:
        for name in content.namelist():
            held = content.read(name)
            if name.endswith((".ssd", ".ssv")):
                held = held.replace(b'version="2.0"', b'version="1.0"')
                held = held.replace(b":Float64", b":Real")
            other.writestr(name, held)
    return out


if __name__ == "__main__":
    np.save(
        sys.argv[5], IMPORTERS[sys.argv[1]](sys.argv[2], float(sys.argv[3]), float(sys.argv[4]))
    )
