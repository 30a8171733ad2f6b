"""An episode as kernels alone: all that a page calls, which has neither Python nor numpy.

Its caller fills the arrays of uniform numbers with those of the generators that
`cosim.simulation.batch` draws from. After `start`, every RL step is one of the policies' kernels
(`follow`, `meet`, `plan_all`) and `step`. The bits are those of a batch.
"""

from typing import Any, NamedTuple

import numpy as np

from agent.mdp.greedy import GreedyPolicy, on_grid
from agent.mdp.grid import least_rotation_argmax
from agent.mdp.interpretations import Process
from agent.moves.group import Group, plan
from agent.moves.pair import PairTimes, pair_values
from agent.moves.times import numbered
from agent.training.policy import GroupPolicy, PairPolicy, Policy
from cosim.base.errors import UserError
from cosim.base.jit import inlined, kernel
from cosim.coupling.assembly import write_noise
from cosim.coupling.master import run_periods
from cosim.coupling.plant import Plant
from cosim.coupling.signals import (
    RawSamples,
    Samples,
    State,
    new_raw_samples,
    new_samples,
    with_sight,
)
from cosim.fmi.calls import Calls, exchange
from cosim.model.params import motors_of
from cosim.model.scenario import touches_obstacle
from cosim.onboard.camera import NOISE, SIGHT, SIGHT_DRAWS, frames_within, spread_of, write_sight
from cosim.onboard.estimation import POSE
from cosim.onboard.features import DIRECTION_COUNT
from cosim.onboard.steering import HOLD, MODE
from cosim.physics.body_state import X, Y, orientation_of, stand
from cosim.physics.draws import VARIED, direction_of, make_factors
from cosim.physics.lanes import Width, width_of
from cosim.physics.properties import gravity, write_own
from cosim.physics.rotation import heading
from cosim.simulation.batch import Batch
from cosim.simulation.episode import RunningEpisode
from cosim.simulation.rules import TICK, Moves, Robots, Rules, adopt, conclude, put_down, robots_of

MOTORS_FAILED = -1  # in place of an outcome's rank
_touches = inlined(touches_obstacle)


class Tables(NamedTuple):
    """What a policy with tables decides by."""

    process: Process
    best: np.ndarray  # (N, states) uint8, a bit for each of the best directions


class Times(NamedTuple):
    """What robots decide by that know times of moves."""

    times: PairTimes | Group
    columns: int
    rows: int
    facings: int


class Varied(NamedTuple):
    """What episodes draw from a world: parameters of motors, and where the floor falls."""

    draws: np.ndarray  # (4 N M + 1,) uniform numbers of an episode
    spread: float  # of the factors
    usual: np.ndarray  # (M, 4) K_T, R, J and r of the configuration
    own: np.ndarray  # (4, M, B) the same of every motor
    references: np.ndarray  # (4,) uint32, of these parameters in the FMU; none without spread
    tilt_deg: float  # of the floor
    g: float  # m/s²


class Play(NamedTuple):
    """One episode of N robots, and room for an RL step of n control periods."""

    decides: Any  # `Tables` or `Times`
    plant: Plant
    periods: int  # control periods that `step` simulates: n, or less to see what is within it
    state: State
    robots: Robots  # of the state
    samples: Samples  # room for n periods
    raw: RawSamples  # without ticks
    calls: Calls  # of the motors
    width: Width
    rules: Rules
    moves: Moves
    cells: np.ndarray  # (N, 2) int64, where robots start
    wanted: np.ndarray  # (N,) int64, directions that the policy chose
    noise: np.ndarray  # (n, B, M) of the motors
    amplitude: float  # of this noise
    hold: int  # control periods that a value of it lasts
    # values, left: see `write_noise`
    values: np.ndarray
    left: np.ndarray
    noise_draws: np.ndarray  # (N M, draws) uniform numbers, of each motor for an RL step
    sight_draws: np.ndarray  # (N, draws) uniform numbers, of each robot's camera for an RL step
    spread: tuple[float, float, float]  # of the camera, see `spread_of`
    cameras: np.ndarray  # (B, CAMERA_SIZE) as they begin
    varied: Varied
    asked: np.ndarray  # (3,) a robot, and x and y in m of where it is put


def new_play(batch: Batch, episode: RunningEpisode, decides: Any = ()) -> Play:
    """Return the episode that has begun in a batch with one place, driven by compiled code."""
    config, robots, state = batch.config, batch.robots, batch.state
    periods, columns = config.periods_per_step, state.bodies.motion.shape[1]
    sizes, sensor = config.robot.sizes, config.world.camera
    motors, noise, spread = robots * sizes[0], episode.noise, config.world.motor_spread or 0.0
    frames = frames_within(sensor, config.timing.rl_step_s)
    each, names = motors_of(config.robot, config.motor), ("K_T", "R", "J", "r")
    references: list[int] = []
    usual = np.array([[getattr(motor, name) for name in names] for motor in each])
    motor = batch.driver.motors.array
    assert motor is not None
    if spread and motor.fmu.arrays:
        references = [motor.fmu.parameter(name, tunable=True) for name in names]
    return Play(
        decides,
        batch.plant,
        periods,
        with_sight(state, np.zeros((frames, columns, NOISE))),
        robots_of(state, 0),
        new_samples(periods, columns, sizes),
        new_raw_samples(0, columns, sizes),
        batch.driver.motors.calls,
        width_of(batch.driver.lanes),
        episode.rules,
        episode.moves,
        np.array(episode.moves.seen.cells),
        np.zeros(robots, dtype=np.int64),
        np.zeros((periods, columns, sizes[0])),
        noise.amplitude,
        noise.hold,
        np.zeros(motors),
        np.zeros(1, dtype=np.int64),
        np.zeros((motors, -(-periods // noise.hold))),
        np.zeros((robots, frames * SIGHT_DRAWS)),
        spread_of(sensor),
        state.onboard.cameras.copy(),
        Varied(
            np.zeros(motors * VARIED + 1),
            spread,
            usual,
            np.repeat(usual.T[:, :, None], columns, axis=2),
            np.array(references, dtype=np.uint32),
            config.world.floor_tilt_deg,
            config.motor.g,
        ),
        np.zeros(3),
    )


@kernel
def start(play: Play) -> int:
    """Put the robots on `play.cells` in a world made of `play.varied.draws`; return a status."""
    varied, motors, calls = play.varied, len(play.varied.usual), play.calls
    factors, direction_deg = varied.draws[:-1], 0.0
    make_factors(factors, varied.spread)
    if varied.tilt_deg > 0.0:
        direction_deg = direction_of(varied.draws[-1])
    down = gravity(varied.tilt_deg, direction_deg, varied.g)
    moved = np.empty((motors, 2))
    for robot in range(len(play.cells)):
        for motor in range(motors):
            for k in range(VARIED):
                factor = factors[VARIED * (motors * robot + motor) + k]
                varied.own[k, motor, robot] = varied.usual[motor, k] * factor
            moved[motor, 0] = varied.own[3, motor, robot]
            moved[motor, 1] = varied.own[2, motor, robot]
        write_own(play.state.bodies.properties, robot, down, moved)
    put_down(play.rules, play.robots, play.moves, play.cells)
    status = 0
    for k in range(len(varied.references)):
        reference, own = varied.references[k : k + 1].ctypes.data, varied.own[k]
        arguments = (calls.instances[0], reference, 1, own.ctypes.data, own.size)
        status = max(status, exchange(calls.functions.set_float64, arguments))
    return status


def deciding(policy: GreedyPolicy) -> tuple[str, Tables | Times]:
    """Return the name of a policy's kernel, and what it decides by.

    Raises:
        UserError: it has none.
    """
    board = policy.config.scenario
    if isinstance(policy, Policy):
        best = policy.values == policy.values.max(axis=2, keepdims=True)
        return "follow", Tables(policy.process, np.packbits(best, 2, "little")[..., 0])
    if isinstance(policy, PairPolicy):
        return "meet", Times(policy.times, board.columns, board.rows, policy.config.facings)
    if isinstance(policy, GroupPolicy):
        return "plan_all", Times(policy.group, board.columns, board.rows, policy.config.facings)
    raise UserError(
        f"the method {policy.config.method} has no kernel that a page could play; choose paper, "
        "moves, shortest, fastest or planned"
    )


@kernel
def follow(play: Play) -> int:
    """Write the directions of a policy with tables to `play.wanted`; return 0."""
    seen = play.moves.seen
    _, states = on_grid(play.decides.process, seen)
    row = np.empty(DIRECTION_COUNT, dtype=np.uint8)
    for i in range(len(states)):
        for a in range(DIRECTION_COUNT):
            row[a] = (play.decides.best[i, states[i]] >> a) & 1
        play.wanted[i] = least_rotation_argmax(row, seen.direction[i])
    return 0


@kernel
def meet(play: Play) -> int:
    """Write the directions of a pair that drives by its times likewise."""
    seen, decides = play.moves.seen, play.decides
    cells, goals, axes = numbered(seen, decides.columns, decides.rows, decides.facings)
    values = np.empty((2, DIRECTION_COUNT), dtype=np.float32)
    pair_values(decides.times, cells, goals, axes, values)
    for i in range(2):
        play.wanted[i] = least_rotation_argmax(values[i], seen.direction[i])
    return 0


@kernel
def plan_all(play: Play) -> int:
    """Write the directions of robots that plan likewise; those under way keep theirs."""
    seen, decides, wanted = play.moves.seen, play.decides, play.wanted
    if not play.moves.awaiting.any():
        return 0
    cells, goals, axes = numbered(seen, decides.columns, decides.rows, decides.facings)
    plan(decides.times, cells, goals, axes, wanted, np.empty(len(cells)))
    for i in range(len(cells)):
        if wanted[i] < 0:
            wanted[i] = seen.direction[i]
    return 0


@kernel
def step(play: Play) -> int:
    """Simulate an RL step, or its beginning, in which robots adopt `play.wanted`.

    Returns:
        The rank of its outcome in `cosim.model.outcome`, or MOTORS_FAILED. `episodes.periods` has
        the number of rows in `play.samples`, less than an RL step when something ended the episode.
    """
    state, moves, noise = play.state, play.moves, play.noise[: play.periods]
    if play.plant.shielded:
        adopt(play.rules, play.robots, moves, play.wanted, play.plant.shield)
    else:
        adopt(play.rules, play.robots, moves, play.wanted, None)
    write_noise(noise, play.noise_draws, play.amplitude, play.hold, play.values, play.left)
    for robot in range(len(play.sight_draws)):
        state.onboard.cameras[robot, SIGHT] = 0.0
        write_sight(state.onboard.sight[:, robot], play.sight_draws[robot], *play.spread)
    state.episodes.periods[0] = 0
    status, _ = run_periods(
        play.plant, state, noise, play.samples, play.raw, play.calls, play.width
    )
    moves.counts[TICK] += state.episodes.periods[0] * play.plant.ticks_per_period
    return MOTORS_FAILED if status else conclude(play.rules, play.robots, moves, False)


@kernel
def place(play: Play) -> int:
    """Put the robot that is asked for at rest where there is room; return whether there was."""
    state, moves, robot = play.state, play.moves, int(play.asked[0])
    floor, motion, onboard = state.floor, state.bodies.motion, state.onboard
    x, y = play.asked[1], play.asked[2]
    reach = 0.5 * play.plant.pair.diameter
    if not (0.0 <= x < floor.boards[0, 0] and 0.0 <= y < floor.boards[0, 1]):
        return 0
    if _touches(x, y, reach * reach, floor.obstacles[0]):
        return 0
    if _touches(x, y, 0.0, floor.forbidden[robot]):
        return 0
    for other in range(play.plant.robots):
        away_x, away_y = motion[X, other] - x, motion[Y, other] - y
        if other != robot and away_x * away_x + away_y * away_y <= 4.0 * reach * reach:
            return 0
        if floor.owners[other] != robot and _touches(x, y, 0.0, floor.targets[other : other + 1]):
            return 0
    angle = heading(orientation_of(motion[:, robot]))
    stand(motion[:, robot], play.rules.height_m, x, y, angle)
    onboard.estimates[robot] = onboard.shields[robot] = 0.0
    onboard.cameras[robot] = play.cameras[robot]
    pose = onboard.estimates[robot]
    pose[POSE], pose[POSE + 1], pose[POSE + 2] = x, y, angle
    onboard.commands[robot, MODE] = HOLD
    moves.arrived[robot], moves.moving[robot] = False, True  # so that it arrives on its target
    conclude(play.rules, play.robots, moves, False)
    return 1
