"""The robot FMU, driven by bare C calls, and the project's own kernels to compare it with."""

import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.base.jit import kernel
from cosim.coupling.assembly import new_plant, robot_properties
from cosim.coupling.plant import Plant, begin_step, exchanged, react, step_robots
from cosim.coupling.signals import State, new_state
from cosim.model.config import CoSimConfig
from cosim.physics.body import stepped
from cosim.physics.body_state import read_body, standing_state, write_body
from cosim.physics.forces import motor_wrench
from cosim.physics.lanes import width_of
from cosim.physics.properties import read_params
from cosim.physics.rotation import rotation_matrix, to_body
from fmus.build import build_fmus, instantiation_token
from fmus.compiler import host_target
from fmus.variables import TIME_REFERENCE, load_table

TABLE = load_table("MiniRobot")
REFERENCE = {"time": TIME_REFERENCE} | {v.name: v.reference for v in TABLE.variables}
# In the layout of `cosim.physics.body_state`, but for the impulses, which are forces here.
POSE = ("x", "y", "z", "q_w", "q_x", "q_y", "q_z")
VELOCITY = ("v_x", "v_y", "v_z", "omega_x", "omega_y", "omega_z")
FRICTION = tuple(f"T_{foot}_{axis}" for foot in "ABC" for axis in "xyz")
BODY = (*POSE, *VELOCITY, "N_A", "N_B", "N_C", *FRICTION)
FORCES = slice(13, 25)
REACTIONS = ("d_D", "d_E")
INPUTS = tuple(f"{name}_{motor}" for name in ("theta", "omega", "omega_dot") for motor in "DE")
_ONE = width_of(1)


@kernel
def _step(plant: Plant, state: State, rows: np.ndarray, found: np.ndarray) -> None:
    for k in range(len(rows)):
        if plant.jacobi:
            for row in range(6):
                state.outputs[row, 0] = rows[k, row]
        begin_step(plant, state)
        for row in range(6):
            state.outputs[row, 0] = rows[k, row]
        for tick in range(plant.ticks_per_step):
            step_robots(plant, state, 0, tick, _ONE)
        if plant.jacobi:
            # A master knows the angles at the end, for the reaction; a body does not.
            for motor in range(2):
                angle = exchanged(plant, state, motor, 0, plant.ticks_per_step - 1, _ONE)[0]
                state.outputs[motor, 0] = angle
        react(plant, state)
        found[k, :25] = state.bodies[:, 0]
        found[k, 25:] = state.inputs[4:, 0]


@kernel
def push(plant: Plant, state: State, force: tuple[float, float], torque: float) -> None:
    """One tick of a robot with motors at rest under a force (world frame, N) and a torque (N m)."""
    body = read_body(state.bodies, 0, _ONE)
    params = read_params(state.properties, 0, _ONE, plant.body)
    d, e = motor_wrench(plant.mount_d, 0.0, 0.0, 0.0), motor_wrench(plant.mount_e, 0.0, 0.0, 0.0)
    x, y, z = to_body(rotation_matrix(body.orientation), (force[0], force[1], 0.0))
    total = (d[0] + e[0] + x, y, d[1] + e[1] + z)
    moment = (d[2] + e[2], d[3] + e[3], d[4] + e[4] + torque)
    write_body(state.bodies, 0, _ONE, stepped(body, params, total, moment))


class Kernels:
    """One robot moved by the kernels of the co-simulation."""

    def __init__(self, config: CoSimConfig, x_m: float, y_m: float) -> None:
        self.config = config
        self.plant = new_plant(config, 1, end_on_collision=False)
        self.state = new_state(1, 1, 1)
        self.state.properties[:, 0] = robot_properties(config)
        self.state.bodies[:, 0] = standing_state(config.robot, x_m, y_m, 0.0)

    def run(self, rows: np.ndarray) -> np.ndarray:
        """Body and reactions (n, 27) after each communication step, from signals (n, 6)."""
        found = np.empty((len(rows), 27))
        _step(self.plant, self.state, rows, found)
        found[:, FORCES] /= self.config.timing.dt_s
        return found


@pytest.fixture(scope="session")
def robot_fmus(tmp_path_factory: pytest.TempPathFactory) -> dict[int, Path]:
    """The FMU of each standard, for this machine."""
    folder = tmp_path_factory.mktemp("robots")
    paths = build_fmus(
        {"2": folder / "fmi2.fmu", "3": folder / "fmi3.fmu"}, [host_target()], model="MiniRobot"
    )
    return dict(zip((2, 3), paths, strict=True))


@pytest.fixture(scope="session")
def robot_library(robot_fmus: dict[int, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    with zipfile.ZipFile(robot_fmus[3]) as archive:
        (name,) = (n for n in archive.namelist() if n.startswith(f"binaries/{host_target()}/"))
        return Path(archive.extract(name, tmp_path_factory.mktemp("robot")))


@pytest.fixture
def robot(instance: Callable[..., Any], robot_library: Path) -> Callable[..., Any]:
    """Makes an instance of MiniRobot."""
    token = instantiation_token(TABLE)

    def make(fmi: int = 3, library: Path = robot_library, **options: Any) -> Any:
        made = instance(fmi, library=library, token=token, **options)
        made.reference = REFERENCE
        return made

    return make
