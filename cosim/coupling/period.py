"""The two ends of a control period, in compiled code.

At its start robots are located, kept apart and steered, and motors get inputs; at its end signals
are sampled, and episodes in which something happened end.
"""

import math

import numpy as np

from cosim.base.jit import inlined
from cosim.coupling.plant import Plant
from cosim.coupling.signals import (
    AIRBORNE,
    FOOT,
    FRICTION_X,
    FRICTION_Y,
    IMPACT,
    LANDING,
    LIFTED,
    NORMAL,
    SLIPPING,
    UNSOLVED,
    RawSamples,
    Samples,
    State,
)
from cosim.model.outcome import COLLISION, OUT_OF_BOARD, RUNNING
from cosim.onboard.camera import INTERVAL, update_estimate
from cosim.onboard.estimation import COVARIANCE, POSE, take_command
from cosim.onboard.shield import Ground, guard
from cosim.onboard.steering import (
    COURSE,
    HEADING_ERROR,
    MODE,
    SPEED,
    YAW_RATE,
    pulse,
    steer,
)
from cosim.physics.body_state import (
    NORMALS,
    OF_LEG,
    Q_W,
    V_X,
    W_X,
    W_Z,
    X,
    Y,
    Z,
    frictions,
    is_upright,
    legs_row,
    orientation_of,
    read_vector,
)
from cosim.physics.collision import find_near_obstacles, find_near_pairs
from cosim.physics.inertia import at_axis
from cosim.physics.lanes import width_of
from cosim.physics.neighbours import FOUND, Grid, find_near, list_by_cells
from cosim.physics.properties import MU, feel_patches, read_params
from cosim.physics.rotation import Vector, heading, plus, rotation_matrix, to_world

# Faults, in place of an outcome: the model does not describe the robot from then on, see
# `cosim.coupling.master.FaultError`.
TIPPED, DIVERGED = 100, 101
# Share of ticks whose contacts may stay unsolved. The robot's speed is wrong by up to a tenth where
# 3 % do. LEAST_UNSOLVED: ticks in a row, in addition to it.
UNSOLVED_SHARE, LEAST_UNSOLVED = 0.01, 1000.0

_ONE = width_of(1)


@inlined
def begin_period(plant: Plant, state: State, noise: np.ndarray, lanes: int) -> None:
    """Steer every robot and put the motors' inputs in place; those of ended episodes stop.

    `noise` is (B, motors), speed measurement noise of this period over each motor's set point.
    """
    period_s = plant.ticks_per_period * plant.body.dt
    robots, columns, motors = plant.robots, state.bodies.shape[1], len(plant.mounts)
    for row in range(state.statistics.shape[0]):
        if row < NORMAL or (row - LANDING) % FOOT != 0:  # whether a foot lands outlasts the period
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
                _locate(plant, state, column)
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
                    plant.steering,
                    plant.shield,
                )
        for column in range(first, first + robots):
            if not state.running[episode]:
                for row in range(2 * motors):
                    state.inputs[row, column] = 0.0
                for motor in range(motors):
                    state.set_points[motor, column] = 0.0
                continue
            _steer(plant, state, column, period_s)
            for motor in range(motors):
                omega = state.set_points[motor, column]
                state.inputs[motor, column] = _motor_input(plant, motor, omega)
                state.inputs[motors + motor, column] = noise[column, motor] * abs(omega)
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
def _motor_input(plant: Plant, motor: int, omega: float) -> float:
    """Return the input of a motor for a set point in rad/s: the set point itself, or a voltage."""
    if not plant.open_loop or omega == 0.0:
        return omega
    per_speed, friction = plant.voltages[motor]
    return per_speed * omega + math.copysign(friction, omega)


@inlined
def _locate(plant: Plant, state: State, column: int) -> None:
    """Find out where a robot is, as far as it can be known."""
    body, camera, sight = state.bodies[:, column], state.cameras[column], state.sight[:, column]
    pose = (body[X], body[Y], heading(orientation_of(body)))
    estimate = state.estimates[column]
    update_estimate(camera, state.frames[column], estimate, sight, pose, plant.estimator)


@inlined
def _steer(plant: Plant, state: State, column: int, period_s: float) -> None:
    """Put the set points of a robot in place by where it thinks it is."""
    command, estimate = state.commands[column], state.estimates[column]
    x, y, angle = estimate[POSE], estimate[POSE + 1], estimate[POSE + 2]
    set_points = state.set_points[:, column]
    steer(command, x, y, angle, period_s, plant.steering, set_points)
    driven = False
    for k in range(len(plant.mounts)):
        driven = driven or set_points[k] != 0.0
    if plant.steering.pulse_s > 0.0:
        pulse(command, period_s, plant.steering, set_points)
    if state.cameras[column, INTERVAL] > 0.0:
        commanded = command[SPEED], command[COURSE], command[YAW_RATE], driven
        take_command(estimate, *commanded, period_s, plant.estimator)


@inlined
def sample_tick(plant: Plant, state: State, raw: RawSamples, row: int) -> None:
    """Write one tick of a burst."""
    for column in range(state.running.shape[0] * plant.robots):
        body = state.bodies[:, column]
        for axis in range(3):
            raw.position[row, column, axis] = body[X + axis]
        motors = len(plant.mounts)
        for motor in range(motors):
            raw.theta[row, column, motor] = state.outputs[motor, column]
            raw.omega[row, column, motor] = state.outputs[motors + motor, column]
        feet = len(plant.body.contact.feet)
        for foot in range(feet):
            raw.normal[row, column, foot] = body[NORMALS + foot] / plant.body.dt
            for axis in range(2):
                impulse = body[frictions(feet) + 3 * foot + axis]
                raw.friction[row, column, 2 * foot + axis] = impulse / plant.body.dt


@inlined
def end_period(plant: Plant, state: State, samples: Samples, row: int) -> int:
    """Sample a control period at `row`, and end the episodes in which something happened.

    The board is judged here: robots move by some micrometres within a period. Returns the number of
    running episodes; 0 after a fault, which ends them all.
    """
    robots = plant.robots
    going_on, worst = 0, RUNNING
    for episode in range(state.running.shape[0]):
        if not state.running[episode]:
            continue
        first = episode * robots
        targets, lists, board = state.targets, state.near_targets, state.boards[episode]
        reach = 2.0 * state.cells_m[episode]  # a centre is closer to its cell's corner
        grid = list_by_cells(lists, targets[:, 0], targets[:, 1], first, robots, board, reach)
        happened = RUNNING
        for column in range(first, first + robots):
            _sample(plant, state, samples, row, column)
            state.events[column] = _event(plant, state, episode, column, grid)
            happened = max(happened, state.events[column])
        state.periods[episode] = row + 1
        worst = max(worst, happened)
        if happened == RUNNING:
            going_on += 1
            continue
        state.running[episode] = 0
        for k in range(state.bodies.shape[0]):
            for column in range(first, first + robots):
                state.ended[k, column] = state.bodies[k, column]
    return going_on if worst < TIPPED else 0


@inlined
def _event(plant: Plant, state: State, episode: int, column: int, grid: Grid) -> int:
    """RUNNING, COLLISION, OUT_OF_BOARD or a fault of one robot."""
    x, y, board = state.bodies[X, column], state.bodies[Y, column], state.boards[episode]
    endless = board[0] == math.inf
    if not endless and not (0.0 <= x <= board[0] and 0.0 <= y <= board[1]):
        return OUT_OF_BOARD
    if _is_beyond_edge(plant, state, column):
        if state.bodies[Z, column] < 0.0:
            return OUT_OF_BOARD
    elif not is_upright(state.bodies[:, column]):
        return TIPPED
    unsolved = state.statistics[UNSOLVED, column] - UNSOLVED_SHARE * plant.ticks_per_period
    state.unsolved[column] = max(0.0, state.unsolved[column] + unsolved)
    if state.unsolved[column] > LEAST_UNSOLVED:
        return DIVERGED
    if not plant.end_on_collision:
        return RUNNING
    if state.touching[column] > 0.0:
        return COLLISION
    for k in range(state.forbidden.shape[1]):
        if _is_within(state.forbidden[column, k], x, y):
            return COLLISION
    lists = state.near_targets
    for k in range(grid.first, grid.first + find_near(lists, grid, x, y)):
        target = lists[FOUND, k]
        if state.owners[target] != column and _is_within(state.targets[target], x, y):
            return COLLISION
    return RUNNING


@inlined
def _is_beyond_edge(plant: Plant, state: State, column: int) -> bool:
    """Return whether a foot of a robot has no floor below it."""
    beyond = False
    for foot in range(len(plant.body.contact.feet)):
        beyond = beyond or state.properties[MU + foot, column] < 0.0
    return beyond


@inlined
def _is_within(rectangle: np.ndarray, x: float, y: float) -> bool:
    """Return whether a point is in a rectangle left, bottom, right, top."""
    return rectangle[0] <= x < rectangle[2] and rectangle[1] <= y < rectangle[3]


@inlined
def _sample(plant: Plant, state: State, samples: Samples, row: int, column: int) -> None:
    ticks = plant.ticks_per_period
    period_s = ticks * plant.body.dt
    body, statistics = state.bodies[:, column], state.statistics[:, column]
    motors = len(plant.mounts)
    for motor in range(motors):
        samples.theta[row, column, motor] = state.outputs[motor, column]
        samples.omega[row, column, motor] = state.outputs[motors + motor, column]
        samples.omega_des[row, column, motor] = state.set_points[motor, column]
        samples.disturbance[row, column, motor] = state.inputs[2 * motors + motor, column]
        samples.voltage[row, column, motor] = state.electrical[motor, column]
        samples.current[row, column, motor] = state.electrical[motors + motor, column]
        samples.command[row, column, motor] = state.electrical[2 * motors + motor, column]
        samples.integral[row, column, motor] = state.electrical[3 * motors + motor, column]
        samples.omega_dot[row, column, motor] = state.outputs[2 * motors + motor, column]
        samples.noise[row, column, motor] = state.inputs[motors + motor, column]
    velocity = _axis_velocity(plant, state, column)
    for axis in range(3):
        samples.position[row, column, axis] = body[X + axis]
        samples.velocity[row, column, axis] = velocity[axis]
    for k in range(4):
        samples.quaternion[row, column, k] = body[Q_W + k]
    samples.yaw_rate[row, column] = body[W_Z]
    for foot in range(len(plant.body.contact.feet)):
        first = FOOT * foot
        x, y = statistics[first + FRICTION_X], statistics[first + FRICTION_Y]
        samples.normal_mean[row, column, foot] = statistics[first + NORMAL] / period_s
        samples.friction_mean[row, column, foot] = math.sqrt(x * x + y * y) / period_s
        samples.impact[row, column, foot] = statistics[first + IMPACT]
        samples.slipping_share[row, column, foot] = statistics[first + SLIPPING] / ticks
    for leg in range(len(plant.body.contact.legs)):
        first = legs_row(len(plant.body.contact.feet)) + OF_LEG * leg
        for axis in range(3):
            samples.deflection[row, column, 3 * leg + axis] = body[first + axis]
    samples.lifted_share[row, column] = statistics[LIFTED] / ticks
    samples.airborne_share[row, column] = statistics[AIRBORNE] / ticks
    samples.heading_error[row, column] = state.commands[column, HEADING_ERROR]
    samples.mode[row, column] = state.commands[column, MODE]
    estimate = state.estimates[column]
    if state.cameras[column, INTERVAL] == 0.0:  # what decides next knows the pose of now
        estimate[POSE], estimate[POSE + 1] = body[X], body[Y]
        estimate[POSE + 2] = heading(orientation_of(body))
    for k in range(3):
        samples.estimate[row, column, k] = estimate[POSE + k]
        for i in range(k + 1):
            # 0; 1, 2; 3, 4, 5 of the lower triangle: xx, xy, yy, x heading, y heading, heading
            samples.covariance[row, column, k * (k + 1) // 2 + i] = estimate[COVARIANCE + 3 * k + i]
    samples.touching_share[row, column] = state.touching[column] / ticks


@inlined
def _axis_velocity(plant: Plant, state: State, column: int) -> Vector:
    """Velocity of a robot's axis at the height of its centre of mass, world frame, m/s."""
    params = read_params(state.properties, column, _ONE, plant.body)
    velocity = read_vector(state.bodies, V_X, column, _ONE)
    if params.off_axis:
        omega = read_vector(state.bodies, W_X, column, _ONE)
        turning = at_axis((0.0, 0.0, 0.0), omega, params)
        matrix = rotation_matrix(orientation_of(state.bodies[:, column]))
        velocity = plus(velocity, 1.0, to_world(matrix, turning))
    return velocity


@inlined
def restore_ended(plant: Plant, state: State) -> None:
    """Put the bodies of ended episodes back to where they were at their end.

    Lanes cannot stand still while others move: what they did after the end is dropped.
    """
    for episode in range(state.running.shape[0]):
        if not state.running[episode]:
            first = episode * plant.robots
            for k in range(state.bodies.shape[0]):
                for column in range(first, first + plant.robots):
                    state.bodies[k, column] = state.ended[k, column]
