"""The FMU under test, driven through fmpy's own Python classes."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.fmi3 import FMU3Slave

from fmus.build import cached_fmu

OUTPUTS = ("theta", "omega", "omega_dot", "V_s", "i")


class Rig:
    """One co-simulation instance in Step Mode, and what it logged."""

    def __init__(self, folder: str, description: Any, **start: float | bool) -> None:
        self.reference = {v.name: v.valueReference for v in description.modelVariables}
        self.messages: list[str] = []
        self.fmu = FMU3Slave(
            guid=description.guid,
            unzipDirectory=folder,
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName="rig",
        )
        self.fmu.instantiate(logMessage=None)
        self.set(**start)
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()
        self.time_s = 0.0
        self._ticks = 0

    def set(self, **values: float | bool) -> None:
        for name, value in values.items():
            setter = {bool: self.fmu.setBoolean, int: self.fmu.setInt64, float: self.fmu.setFloat64}
            setter[type(value)]([self.reference[name]], [value])

    def get(self, *names: str) -> list[float]:
        return self.fmu.getFloat64([self.reference[name] for name in names])

    def step(self, step_s: float) -> None:
        self.fmu.doStep(self.time_s, step_s)
        self.time_s += step_s

    def run(self, duration_s: float, step_s: float = 1e-3, names: tuple[str, ...] = OUTPUTS):
        """Times (n + 1,) and one array (n + 1,) per name, from now on."""
        start, count = self.time_s, round(duration_s / step_s)
        rows = [self.get(*names)]
        for k in range(count):
            self.fmu.doStep(start + k * step_s, step_s)
            rows.append(self.get(*names))
        self.time_s = start + count * step_s
        columns = np.array(rows).T
        return start + np.arange(count + 1) * step_s, dict(zip(names, columns, strict=True))


@pytest.fixture(scope="session")
def fmu() -> Path:
    return cached_fmu()


@pytest.fixture(scope="session")
def rig(fmu: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[..., Rig]]:
    folder = str(tmp_path_factory.mktemp("fmu"))
    fmpy.extract(str(fmu), folder)
    description = fmpy.read_model_description(folder)
    rigs: list[Rig] = []

    def make(**start: float | bool) -> Rig:
        rigs.append(Rig(folder, description, **start))
        return rigs[-1]

    yield make
    for each in rigs:
        each.fmu.fmi3FreeInstance(each.fmu.component)
