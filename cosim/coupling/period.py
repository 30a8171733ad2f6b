"""The start of a control period: robots are located, kept apart and steered; motors get inputs."""

import math

import numpy as np

from cosim.base.jit import inlined
from cosim.coupling.plant import Plant
from cosim.coupling.signals import LANDING, MOTORS, State
from cosim.onboard.camera import INTERVAL, update_estimate
from cosim.onboard.estimation import POSE, take_command
from cosim.onboard.shield import Ground, guard
from cosim.onboard.steering import SPEED, YAW_RATE, steer
from cosim.physics.body_state import X, Y, orientation_of
from cosim.physics.collision import find_near_obstacles, find_near_pairs
from cosim.physics.properties import feel_patches
from cosim.physics.rotation import heading


@inlined
def begin_period(plant: Plant, state: State, noise: np.ndarray, lanes: int) -> None:
    """Steer every robot and put the motors' inputs in place; those of ended episodes stop.

    Args:
        plant: constants.
        state: variables; commands and inputs change.
        noise: (B, 2) speed measurement noise of this period, over each motor's set point.
        lanes: of the vectors.
    """
    period_s = plant.ticks_per_period * plant.body.dt
    robots, columns = plant.robots, state.bodies.shape[1]
    for row in range(LANDING):
        for column in range(columns):
            state.statistics[row, column] = 0.0
    for column in range(columns):
        state.touching[column] = 0.0
        state.busy[column] = 0
    near = walls = 0
    for episode in range(state.running.shape[0]):
        first = episode * robots
        if state.running[episode]:
            for column in range(first, first + robots):
                _look(plant, state, column)
            if plant.shielded:
                ground = Ground(
                    state.boards[episode],
                    state.margins_m[episode],
                    state.cells_m[episode],
                    state.obstacles[episode],
                    state.forbidden,
                    state.targets,
                    state.owners,
                )
                guard(
                    state.commands,
                    state.estimates,
                    state.shields,
                    first,
                    robots,
                    ground,
                    state.near_robots,
                    state.near_targets,
                    state.near_zone,
                    plant.pair.diameter,
                    plant.shield,
                    plant.portable,
                )
        for column in range(first, first + robots):
            if not state.running[episode]:
                for row in range(2 * MOTORS):
                    state.inputs[row, column] = 0.0
                for motor in range(MOTORS):
                    state.set_points[motor, column] = 0.0
                continue
            set_points = _steer(plant, state, column, period_s)
            for motor in range(MOTORS):
                omega = set_points[motor]
                state.set_points[motor, column] = omega
                state.inputs[motor, column] = _motor_input(plant, omega)
                state.inputs[MOTORS + motor, column] = noise[column, motor] * abs(omega)
            state.busy[column - column % lanes] = 1
            walls = find_near_obstacles(
                state.bodies, column, state.obstacles[episode], plant.pair, state.near_walls, walls
            )
            if state.patches.shape[1]:
                feel_patches(
                    state.properties, state.bodies, column, state.patches[episode], plant.body
                )
        if state.running[episode]:
            near = find_near_pairs(
                state.bodies,
                first,
                robots,
                state.boards[episode],
                state.near_robots,
                plant.pair,
                state.near,
                near,
            )
    state.near_count[0], state.near_count[1] = near, walls


@inlined
def _motor_input(plant: Plant, omega: float) -> float:
    """Return the input of a motor for a set point in rad/s: the set point itself, or a voltage."""
    if not plant.open_loop or omega == 0.0:
        return omega
    return plant.volts_per_speed * omega + math.copysign(plant.friction_volts, omega)


@inlined
def _look(plant: Plant, state: State, column: int) -> None:
    """Find out where a robot is, as far as it can be known."""
    body, camera, sight = state.bodies[:, column], state.cameras[column], state.sight[:, column]
    pose = (body[X], body[Y], heading(orientation_of(body), plant.portable))
    estimate = state.estimates[column]
    update_estimate(
        camera, state.frames[column], estimate, sight, pose, plant.estimator, plant.portable
    )


@inlined
def _steer(plant: Plant, state: State, column: int, period_s: float) -> tuple[float, float]:
    """Set points of a robot by where it thinks it is."""
    command, estimate = state.commands[column], state.estimates[column]
    x, y, angle = estimate[POSE], estimate[POSE + 1], estimate[POSE + 2]
    set_points = steer(command, x, y, angle, period_s, plant.steering, plant.portable)
    if state.cameras[column, INTERVAL] > 0.0:
        driven = set_points[0] != 0.0 or set_points[1] != 0.0
        commanded = command[SPEED], command[YAW_RATE], driven
        take_command(estimate, *commanded, period_s, plant.estimator, plant.portable)
    return set_points
