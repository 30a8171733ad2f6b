"""An episode as kernels alone: all that a page calls, which has neither Python nor numpy.

Its caller fills the arrays of uniform numbers, each with those of numpy's generators that
`cosim.simulation.batch` draws from. `new_play` makes an episode at its start; then, from RL step to
RL step: one of the policies' kernels (`follow`, `meet`, `plan_all`), `begin_step`, `advance` until
all periods have passed, and `end_step`. The bits are those of a batch.
"""

from typing import NamedTuple

import numpy as np

from agent.mdp.greedy import on_grid
from agent.mdp.grid import least_rotation_argmax
from agent.mdp.interpretations import Process
from agent.moves.group import Group, plan
from agent.moves.pair import PairTimes, pair_values
from agent.moves.times import numbered
from cosim.base.jit import kernel
from cosim.coupling.assembly import write_noise
from cosim.coupling.master import run_periods
from cosim.coupling.plant import Plant
from cosim.coupling.signals import RawSamples, Samples, State, new_raw_samples, new_samples
from cosim.fmi.calls import Calls
from cosim.model.params import ShieldParams, motors_of
from cosim.onboard.camera import NOISE, SIGHT, SIGHT_DRAWS, frames_within, spread_of, write_sight
from cosim.onboard.features import DIRECTION_COUNT, Observation
from cosim.physics.draws import VARIED, direction_of, make_factors
from cosim.physics.lanes import Width, width_of
from cosim.physics.properties import gravity, write_own
from cosim.simulation.batch import Batch
from cosim.simulation.episode import RunningEpisode
from cosim.simulation.rules import TICK, Moves, Robots, Rules, adopt, conclude, put_down, robots_of


class Varied(NamedTuple):
    """What episodes draw from a world: parameters of motors, and where the floor falls."""

    draws: np.ndarray  # (4 N M + 1,) uniform numbers of an episode
    spread: float  # of the factors
    usual: np.ndarray  # (M, 4) K_T, R, J and r of the configuration
    own: np.ndarray  # (4, M, B) the same of every motor, which the motors need at their start
    tilt_deg: float  # of the floor
    g: float  # m/s²


class Play(NamedTuple):
    """One episode of N robots, and room for an RL step of n control periods."""

    plant: Plant
    state: State
    robots: Robots  # of the state
    samples: Samples  # room for n periods
    raw: RawSamples  # without ticks
    calls: Calls  # of the motors
    width: Width
    rules: Rules
    moves: Moves
    shield: ShieldParams | None
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
    varied: Varied


def new_play(batch: Batch, episode: RunningEpisode) -> Play:
    """Return the episode that has begun in a batch with one place, driven by compiled code."""
    config, robots, state = batch.config, batch.robots, batch.state
    periods, columns = config.periods_per_step, state.bodies.shape[1]
    sizes, sensor = (config.robot.motors_count, config.robot.feet_count), config.world.camera
    motors, noise = robots * sizes[0], episode.noise
    frames = frames_within(sensor, config.timing.rl_step_s)
    each = motors_of(config.robot, config.motor)
    usual = np.array([(motor.K_T, motor.R, motor.J, motor.r) for motor in each])
    return Play(
        batch.plant,
        state._replace(sight=np.zeros((frames, columns, NOISE))),
        robots_of(state, 0),
        new_samples(periods, columns, *sizes),
        new_raw_samples(0, columns, *sizes),
        batch.driver.motors.calls,
        width_of(batch.driver.lanes),
        episode.rules,
        episode.moves,
        config.shield,
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
        Varied(
            np.zeros(motors * VARIED + 1),
            config.world.motor_spread or 0.0,
            usual,
            np.repeat(usual.T[:, :, None], columns, axis=2),
            config.world.floor_tilt_deg,
            config.motor.g,
        ),
    )


@kernel
def start(play: Play) -> None:
    """Put the robots on `play.cells` of a drawn world; all else is as `new_play` returned it.

    Before, `play.varied.draws` gets its numbers; after it, the motors begin with `play.varied.own`.
    """
    varied, motors = play.varied, len(play.varied.usual)
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
            moved[motor, 0], moved[motor, 1] = (
                varied.own[3, motor, robot],
                varied.own[2, motor, robot],
            )
        write_own(play.state.properties, robot, down, moved)
    put_down(play.rules, play.robots, play.moves, play.cells)


@kernel
def follow(process: Process, best: np.ndarray, seen: Observation, wanted: np.ndarray) -> None:
    """Write the directions (N,) of a policy with tables: see `best_of`."""
    _, states = on_grid(process, seen)
    row = np.empty(DIRECTION_COUNT, dtype=np.uint8)
    for i in range(len(wanted)):
        for a in range(DIRECTION_COUNT):
            row[a] = (best[i, states[i]] >> a) & 1
        wanted[i] = least_rotation_argmax(row, seen.direction[i])


def best_of(values: np.ndarray) -> np.ndarray:
    """(N, states) uint8, a bit for each of the best directions of action values (N, states, 8)."""
    best = values == values.max(axis=2, keepdims=True)
    return np.packbits(best, axis=2, bitorder="little")[..., 0]


@kernel
def meet(times: PairTimes, columns: int, rows: int, seen: Observation, wanted: np.ndarray) -> None:
    """Write the directions (2,) of a pair that drives by its times."""
    cells, goals, axes = numbered(seen, columns, rows)
    values = np.empty((2, DIRECTION_COUNT), dtype=np.float32)
    pair_values(times, cells, goals, axes, values)
    for i in range(2):
        wanted[i] = least_rotation_argmax(values[i], seen.direction[i])


@kernel
def plan_all(group: Group, columns: int, rows: int, seen: Observation, wanted: np.ndarray) -> None:
    """Write the directions (N,) of robots that plan; those under way keep theirs."""
    cells, goals, axes = numbered(seen, columns, rows)
    plan(group, cells, goals, axes, wanted, np.empty(len(cells)))
    for i in range(len(cells)):
        if wanted[i] < 0:
            wanted[i] = seen.direction[i]


@kernel
def begin_step(play: Play) -> None:
    """Have robots adopt `play.wanted`, and make the noise of the RL step."""
    adopt(play.rules, play.robots, play.moves, play.wanted, play.shield)
    write_noise(play.noise, play.noise_draws, play.amplitude, play.hold, play.values, play.left)
    for robot in range(len(play.sight_draws)):
        play.state.cameras[robot, SIGHT] = 0.0
        write_sight(play.state.sight[:, robot], play.sight_draws[robot], *play.spread)


@kernel
def advance(play: Play, begin: int, end: int) -> int:
    """Simulate control periods of the RL step, to the first rows of `play.samples`.

    Returns:
        The number of periods that passed, less when something ended the episode; −1 if motors or
        bodies failed.
    """
    state, count = play.state, play.moves.counts
    state.periods[0] = 0
    status, _ = run_periods(
        play.plant, state, play.noise[begin:end], play.samples, play.raw, play.calls, play.width
    )
    periods = state.periods[0]
    count[TICK] += periods * play.plant.ticks_per_period
    return periods if status == 0 else -1


@kernel
def end_step(play: Play) -> int:
    """Judge the RL step; return the rank of its outcome in `cosim.model.outcome`."""
    return conclude(play.rules, play.robots, play.moves, False)
