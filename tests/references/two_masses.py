"""Two masses on springs, coupled by a third: the test problem of co-simulation, and its solution.

Force–displacement coupling: the first oscillator gets a force and tells where it is, the second
one gets that place, has the coupling spring, and tells its force. Masses of 1 kg, springs of 10,
1000 and 100 N/m; the first mass begins at 1 m. The models solve their own equation exactly for
inputs that hold, so what is wrong is the master's.
"""

import zipfile
from pathlib import Path

import numpy as np

from cosim.fmi.fmu import Fmu, Log, end
from cosim.system.graph import Component, Connection
from cosim.system.system import MasterAlgorithm, System, SystemRun
from tests.references.small import small_fmu

MASS_KG, SPRINGS, COUPLING = 1.0, (10.0, 1000.0), 100.0
STIFF = (1e6, 500.0)  # spring in N/m and damper in N s/m of the stiff coupling
X_0 = (1.0, 0.0)
PLACES = ("first.x", "second.x")


def two_masses(
    folder: Path, standards: tuple[int, int] = (3, 3), interface: str = "CoSimulation"
) -> list[Component]:
    """The oscillators as components, each of its FMI standard, with one interface."""
    place = folder if interface == "CoSimulation" else folder / interface
    place.mkdir(exist_ok=True)
    made = {
        fmi: small_fmu(place / f"{fmi}.fmu", "oscillator", fmi, interfaces=(interface,))
        for fmi in set(standards)
    }
    fmus = {fmi: Fmu(path, exchange=None) for fmi, path in made.items()}
    first, second = SPRINGS
    return [
        Component("first", fmus[standards[0]], {"m": MASS_KG, "k": first, "x": X_0[0]}),
        Component(
            "second", fmus[standards[1]], {"m": MASS_KG, "k": second, "k_c": COUPLING, "x": X_0[1]}
        ),
    ]


CONNECTIONS = [Connection("second.F", "first.F_in"), Connection("first.x", "second.x_in")]


def simulated(
    components: list[Component],
    until_s: float,
    step_s: float,
    algorithm: MasterAlgorithm,
    tolerance: float | None = None,
) -> tuple[SystemRun, System]:
    """The run of the coupled oscillators, and their system as it is then, closed."""
    options = {"algorithm": algorithm, "step_s": step_s, "tolerance": tolerance}
    with System(components, CONNECTIONS, **options) as system:
        return system.run(until_s), system


def stiff_masses(folder: Path) -> tuple[list[Component], list[Connection]]:
    """The oscillators at 1 m with a coupling of 1e6 N/m and 500 N s/m, and their connections."""
    first, second = two_masses(folder)
    stiff = {**second.start, "k_c": STIFF[0], "c_c": STIFF[1], "x": X_0[0]}
    return [first, second._replace(start=stiff)], [
        *CONNECTIONS,
        Connection("first.v", "second.v_in"),
    ]


BONDED = [Connection("second.F", "first.F_in"), Connection("first.v", "second.v_in")]
BOND = ("first.F_in", "second.v_in")
RESIDUAL = "first.F_in residual energy"
STATES = ["first.x", "first.v", "second.x", "second.v", "second.x_in"]


def bonded_masses(folder: Path, able: bool = True) -> list[Component]:
    """The oscillators, of which the second one integrates the speed of the first: a power bond.

    Args:
        folder: of their FMU.
        able: whether it says that it can save its state; it can vary its step in any case.
    """
    first, second = two_masses(folder)
    if not able:
        path, word = folder / "unable.fmu", "canGetAndSetFMUState"
        assert isinstance(first.fmu, Fmu)
        with zipfile.ZipFile(first.fmu.path) as source, zipfile.ZipFile(path, "w") as target:
            for name in source.namelist():
                old = f'{word}="true"'.encode()
                target.writestr(name, source.read(name).replace(old, f'{word}="false"'.encode()))
        first, second = (each._replace(fmu=Fmu(path)) for each in (first, second))
    return [first, second._replace(start={**second.start, "moves": 1.0, "x_in": X_0[0]})]


def stored(run: SystemRun) -> np.ndarray:
    """Energy (n,) of both masses and all springs in J, of a run that records `STATES`."""
    x_1, v_1, x_2, v_2, end = (run.signals[name] for name in STATES)
    springs = SPRINGS[0] * x_1**2 + SPRINGS[1] * x_2**2 + COUPLING * (x_2 - end) ** 2
    return 0.5 * (springs + MASS_KG * (v_1**2 + v_2**2))


def exact_stiff(time_s: np.ndarray) -> np.ndarray:
    """Places (2, n) of both masses with the stiff coupling."""
    coupling = np.array([[1.0, -1.0], [-1.0, 1.0]])
    matrix = np.zeros((4, 4))
    matrix[:2, 2:] = np.eye(2)
    matrix[2:, :2] = -(np.diag(SPRINGS) + STIFF[0] * coupling) / MASS_KG
    matrix[2:, 2:] = -STIFF[1] * coupling / MASS_KG
    values, modes = np.linalg.eig(matrix)
    parts = np.linalg.solve(modes, np.array([X_0[0], X_0[0], 0.0, 0.0]))[:, None]
    return (modes @ (parts * np.exp(values[:, None] * time_s))).real[:2]


def exact(time_s: np.ndarray, start_m: tuple[float, float] = X_0) -> np.ndarray:
    """Places (2, n) of both masses, by the modes of the coupled system."""
    first, second = SPRINGS
    stiffness = [[first + COUPLING, -COUPLING], [-COUPLING, second + COUPLING]]
    squares, modes = np.linalg.eigh(np.array(stiffness) / MASS_KG)
    return modes @ ((modes.T @ start_m)[:, None] * np.cos(np.sqrt(squares)[:, None] * time_s))


def error(run: SystemRun) -> float:
    """Largest error of a place in m."""
    return float(np.abs(places(run) - exact(run.time_s)).max())


def places(run: SystemRun) -> np.ndarray:
    """Places (2, n) of both masses in m."""
    return np.array([run.signals[name] for name in PLACES])


class PythonLoop:
    """The Jacobi master in Python, step by step through fmpy."""

    def __init__(self, components: list[Component]) -> None:
        self._slaves = []
        fmu = self._fmu = components[0].fmu
        assert isinstance(fmu, Fmu)
        for component in components:
            slave = fmu.load(component.name, Log())
            for name, value in component.start.items():
                slave.setFloat64([fmu.variables[name].valueReference], [value])
            slave.enterInitializationMode()
            self._slaves.append(slave)
        self._reference = {name: v.valueReference for name, v in fmu.variables.items()}
        self.outputs = self._get()
        self._set()
        for slave in self._slaves:
            slave.exitInitializationMode()
        self.outputs = self._get()
        self.steps = 0

    def _get(self) -> list[list[float]]:
        places = [self._reference[name] for name in ("x", "v", "F")]
        return [slave.getFloat64(places) for slave in self._slaves]

    def _set(self) -> None:
        first, second = self._slaves
        first.setFloat64([self._reference["F_in"]], [self.outputs[1][2]])
        second.setFloat64([self._reference["x_in"]], [self.outputs[0][0]])

    def run(self, steps: int, step_s: float) -> None:
        """Make this number of steps."""
        for k in range(self.steps, self.steps + steps):
            self._set()
            for slave in self._slaves:
                slave.doStep(k * step_s, step_s)
            self.outputs = self._get()
        self.steps += steps

    def close(self) -> None:
        """Free both."""
        for slave in self._slaves:
            end(slave)
