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
    Bodies,
    MotorSignals,
    RawSamples,
    Samples,
    State,
)
from cosim.model.outcome import COLLISION, OUT_OF_BOARD, RUNNING
from cosim.onboard.camera import INTERVAL, update_estimate
from cosim.onboard.estimation import COVARIANCE, POSE, take_command
from cosim.onboard.shield import guard
from cosim.onboard.state import Floor, Onboard
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
    """Sense, guard and steer: put the motors' inputs in place, of ended episodes those of rest.

    `noise` is (B, motors), speed measurement noise of this period over each motor's set point.
    """
    bodies, contacts, floor, episodes = state.bodies, state.contacts, state.floor, state.episodes
    _begin_counts(bodies.statistics, contacts.touching, episodes.busy)
    near = walls = 0
    for episode in range(episodes.running.shape[0]):
        first = episode * plant.robots
        columns = range(first, first + plant.robots)
        if not episodes.running[episode]:
            for column in columns:
                _rest(plant, state.motors, column)
            continue
        for column in columns:
            _locate(plant, state.onboard, bodies.motion[:, column], column)
        if plant.shielded:
            diameter_m = plant.pair.diameter
            guard(
                state.onboard, floor, episode, plant.robots, diameter_m, plant.steering,
                plant.shield,
            )  # fmt: skip
        for column in columns:
            _steer(plant, state.onboard, state.motors.set_points[:, column], column)
            _set_inputs(plant, state.motors, noise, column)
            episodes.busy[column - column % lanes] = 1
            obstacles = floor.obstacles[episode]
            walls = find_near_obstacles(
                bodies.motion, column, obstacles, plant.pair, contacts.walls, walls
            )
            if floor.patches.shape[1]:
                patches = floor.patches[episode]
                feel_patches(bodies.properties, bodies.motion, column, patches, plant.body)
        board, lists = floor.boards[episode], state.onboard.near_robots
        near = find_near_pairs(
            bodies.motion, first, plant.robots, board, lists, plant.pair, contacts.pairs, near
        )
    contacts.counts[0], contacts.counts[1] = near, walls


@inlined
def _begin_counts(statistics: np.ndarray, touching: np.ndarray, busy: np.ndarray) -> None:
    columns = len(busy)
    for row in range(statistics.shape[0]):
        if row < NORMAL or (row - LANDING) % FOOT != 0:  # whether a foot lands outlasts the period
            for column in range(columns):
                statistics[row, column] = 0.0
    for column in range(columns):
        touching[column] = 0.0
        busy[column] = 0


@inlined
def _rest(plant: Plant, signals: MotorSignals, column: int) -> None:
    """Ask the motors of a robot for rest."""
    motors = len(plant.mounts)
    for row in range(2 * motors):
        signals.inputs[row, column] = 0.0
    for motor in range(motors):
        signals.set_points[motor, column] = 0.0


@inlined
def _set_inputs(plant: Plant, signals: MotorSignals, noise: np.ndarray, column: int) -> None:
    """Put the inputs of a robot's motors in place: set points, or voltages, and the noise."""
    motors = len(plant.mounts)
    for motor in range(motors):
        omega = signals.set_points[motor, column]
        signals.inputs[motors + motor, column] = noise[column, motor] * abs(omega)
        if plant.open_loop and omega != 0.0:
            per_speed, friction = plant.voltages[motor]
            omega = per_speed * omega + math.copysign(friction, omega)
        signals.inputs[motor, column] = omega


@inlined
def _locate(plant: Plant, onboard: Onboard, body: np.ndarray, column: int) -> None:
    """Find out where a robot is, as far as it can be known."""
    camera, frames, sight = onboard.cameras[column], onboard.frames[column], onboard.sight
    pose = (body[X], body[Y], heading(orientation_of(body)))
    estimate = onboard.estimates[column]
    update_estimate(camera, frames, estimate, sight[:, column], pose, plant.estimator)


@inlined
def _steer(plant: Plant, onboard: Onboard, set_points: np.ndarray, column: int) -> None:
    """Put the set points of a robot in place by where it thinks it is."""
    period_s = plant.ticks_per_period * plant.body.dt
    command, estimate = onboard.commands[column], onboard.estimates[column]
    x, y, angle = estimate[POSE], estimate[POSE + 1], estimate[POSE + 2]
    steer(command, x, y, angle, period_s, plant.steering, set_points)
    driven = False
    for k in range(len(plant.mounts)):
        driven = driven or set_points[k] != 0.0
    if plant.steering.pulse_s > 0.0:
        pulse(command, period_s, plant.steering, set_points)
    if onboard.cameras[column, INTERVAL] > 0.0:
        commanded = command[SPEED], command[COURSE], command[YAW_RATE], driven
        take_command(estimate, *commanded, period_s, plant.estimator)


@inlined
def sample_tick(plant: Plant, state: State, raw: RawSamples, row: int) -> None:
    """Write one tick of a burst."""
    for column in range(state.episodes.running.shape[0] * plant.robots):
        body = state.bodies.motion[:, column]
        for axis in range(3):
            raw.position[row, column, axis] = body[X + axis]
        motors = len(plant.mounts)
        for motor in range(motors):
            raw.theta[row, column, motor] = state.motors.outputs[motor, column]
            raw.omega[row, column, motor] = state.motors.outputs[motors + motor, column]
        feet = len(plant.body.feet.places)
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
    robots, bodies, floor, episodes = plant.robots, state.bodies, state.floor, state.episodes
    going_on, worst = 0, RUNNING
    for episode in range(episodes.running.shape[0]):
        if not episodes.running[episode]:
            continue
        first = episode * robots
        targets, lists, board = floor.targets, state.onboard.near_targets, floor.boards[episode]
        reach = 2.0 * floor.cells_m[episode]  # a centre is closer to its cell's corner
        grid = list_by_cells(lists, targets[:, 0], targets[:, 1], first, robots, board, reach)
        happened = RUNNING
        for column in range(first, first + robots):
            _sample(plant, state, samples, row, column)
            event = _event(plant, bodies, column, board)
            if event == RUNNING and plant.end_on_collision:
                touches = state.contacts.touching[column] > 0.0
                x, y = bodies.motion[X, column], bodies.motion[Y, column]
                if touches or _is_forbidden(floor, column, x, y, lists, grid):
                    event = COLLISION
            episodes.events[column] = event
            happened = max(happened, event)
        episodes.periods[episode] = row + 1
        worst = max(worst, happened)
        if happened == RUNNING:
            going_on += 1
            continue
        episodes.running[episode] = 0
        for k in range(bodies.motion.shape[0]):
            for column in range(first, first + robots):
                bodies.ended[k, column] = bodies.motion[k, column]
    return going_on if worst < TIPPED else 0


@inlined
def _event(plant: Plant, bodies: Bodies, column: int, board: np.ndarray) -> int:
    """RUNNING, OUT_OF_BOARD or a fault of one robot."""
    x, y = bodies.motion[X, column], bodies.motion[Y, column]
    endless = board[0] == math.inf
    if not endless and not (0.0 <= x <= board[0] and 0.0 <= y <= board[1]):
        return OUT_OF_BOARD
    beyond = False  # whether a foot has no floor below it
    for foot in range(len(plant.body.feet.places)):
        beyond = beyond or bodies.properties[MU + foot, column] < 0.0
    if beyond:
        if bodies.motion[Z, column] < 0.0:
            return OUT_OF_BOARD
    elif not is_upright(bodies.motion[:, column]):
        return TIPPED
    unsolved = bodies.statistics[UNSOLVED, column] - UNSOLVED_SHARE * plant.ticks_per_period
    bodies.unsolved[column] = max(0.0, bodies.unsolved[column] + unsolved)
    return DIVERGED if bodies.unsolved[column] > LEAST_UNSOLVED else RUNNING


@inlined
def _is_forbidden(
    floor: Floor, column: int, x: float, y: float, lists: np.ndarray, grid: Grid
) -> bool:
    """Return whether a robot's centre may not be at (x, y): in a zone, or on another's target."""
    for k in range(floor.forbidden.shape[1]):
        if _is_within(floor.forbidden[column, k], x, y):
            return True
    for k in range(grid.first, grid.first + find_near(lists, grid, x, y)):
        target = lists[FOUND, k]
        if floor.owners[target] != column and _is_within(floor.targets[target], x, y):
            return True
    return False


@inlined
def _is_within(rectangle: np.ndarray, x: float, y: float) -> bool:
    """Return whether a point is in a rectangle left, bottom, right, top."""
    return rectangle[0] <= x < rectangle[2] and rectangle[1] <= y < rectangle[3]


@inlined
def _sample(plant: Plant, state: State, samples: Samples, row: int, column: int) -> None:
    ticks, signals, onboard = plant.ticks_per_period, state.motors, state.onboard
    period_s = ticks * plant.body.dt
    body, statistics = state.bodies.motion[:, column], state.bodies.statistics[:, column]
    motors = len(plant.mounts)
    for motor in range(motors):
        samples.theta[row, column, motor] = signals.outputs[motor, column]
        samples.omega[row, column, motor] = signals.outputs[motors + motor, column]
        samples.omega_des[row, column, motor] = signals.set_points[motor, column]
        samples.disturbance[row, column, motor] = signals.inputs[2 * motors + motor, column]
        samples.voltage[row, column, motor] = signals.electrical[motor, column]
        samples.current[row, column, motor] = signals.electrical[motors + motor, column]
        samples.command[row, column, motor] = signals.electrical[2 * motors + motor, column]
        samples.integral[row, column, motor] = signals.electrical[3 * motors + motor, column]
        samples.omega_dot[row, column, motor] = signals.outputs[2 * motors + motor, column]
        samples.noise[row, column, motor] = signals.inputs[motors + motor, column]
    velocity = _axis_velocity(plant, state.bodies, column)
    for axis in range(3):
        samples.position[row, column, axis] = body[X + axis]
        samples.velocity[row, column, axis] = velocity[axis]
    for k in range(4):
        samples.quaternion[row, column, k] = body[Q_W + k]
    samples.yaw_rate[row, column] = body[W_Z]
    for foot in range(len(plant.body.feet.places)):
        first = FOOT * foot
        x, y = statistics[first + FRICTION_X], statistics[first + FRICTION_Y]
        samples.normal_mean[row, column, foot] = statistics[first + NORMAL] / period_s
        samples.friction_mean[row, column, foot] = math.sqrt(x * x + y * y) / period_s
        samples.impact[row, column, foot] = statistics[first + IMPACT]
        samples.slipping_share[row, column, foot] = statistics[first + SLIPPING] / ticks
    for leg in range(len(plant.body.contact.legs)):
        first = legs_row(len(plant.body.feet.places)) + OF_LEG * leg
        for axis in range(3):
            samples.deflection[row, column, 3 * leg + axis] = body[first + axis]
    samples.lifted_share[row, column] = statistics[LIFTED] / ticks
    samples.airborne_share[row, column] = statistics[AIRBORNE] / ticks
    samples.heading_error[row, column] = onboard.commands[column, HEADING_ERROR]
    samples.mode[row, column] = onboard.commands[column, MODE]
    estimate = onboard.estimates[column]
    if onboard.cameras[column, INTERVAL] == 0.0:  # what decides next knows the pose of now
        estimate[POSE], estimate[POSE + 1] = body[X], body[Y]
        estimate[POSE + 2] = heading(orientation_of(body))
    for k in range(3):
        samples.estimate[row, column, k] = estimate[POSE + k]
        for i in range(k + 1):
            # 0; 1, 2; 3, 4, 5 of the lower triangle: xx, xy, yy, x heading, y heading, heading
            samples.covariance[row, column, k * (k + 1) // 2 + i] = estimate[COVARIANCE + 3 * k + i]
    samples.touching_share[row, column] = state.contacts.touching[column] / ticks


@inlined
def _axis_velocity(plant: Plant, bodies: Bodies, column: int) -> Vector:
    """Velocity of a robot's axis at the height of its centre of mass, world frame, m/s."""
    params = read_params(bodies.properties, column, _ONE, plant.body)
    velocity = read_vector(bodies.motion, V_X, column, _ONE)
    if params.off_axis:
        omega = read_vector(bodies.motion, W_X, column, _ONE)
        turning = at_axis((0.0, 0.0, 0.0), omega, params)
        matrix = rotation_matrix(orientation_of(bodies.motion[:, column]))
        velocity = plus(velocity, 1.0, to_world(matrix, turning))
    return velocity


@inlined
def restore_ended(plant: Plant, state: State) -> None:
    """Put the bodies of ended episodes back to where they were at their end.

    Lanes cannot stand still while others move: what they did after the end is dropped.
    """
    bodies, running = state.bodies, state.episodes.running
    for episode in range(running.shape[0]):
        if not running[episode]:
            first = episode * plant.robots
            for k in range(bodies.motion.shape[0]):
                for column in range(first, first + plant.robots):
                    bodies.motion[k, column] = bodies.ended[k, column]
