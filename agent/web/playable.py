"""From a policy and a setup to what a page plays: entries, and the memory that they begin with."""

from typing import NamedTuple

import numpy as np

from agent.mdp.greedy import GreedyPolicy
from agent.mdp.interpretations import Process
from agent.moves.group import Group
from agent.moves.pair import PairTimes
from agent.training.policy import GroupPolicy, PairPolicy, Policy
from agent.web import playing
from agent.web.compiler import compiled
from agent.web.image import Image, image_of
from agent.web.playing import Play, advance, begin_step, best_of, end_step, new_play
from cosim.base.errors import UserError
from cosim.base.jit import inlined, kernel
from cosim.fmi.calls import FMI_WARNING, exchange
from cosim.fmi.motor import MotorFmu
from cosim.model.scenario import touches_obstacle
from cosim.onboard.estimation import POSE
from cosim.onboard.steering import HOLD, MODE
from cosim.physics.body_state import X, Y, orientation_of, stand
from cosim.physics.rotation import heading
from cosim.simulation import rules
from cosim.simulation.batch import Batch
from cosim.simulation.options import Setup
from cosim.simulation.simulate import draw_episode

_touches = inlined(touches_obstacle)


class Tables(NamedTuple):
    """What a policy with tables decides by."""

    process: Process
    best: np.ndarray  # see `agent.web.playing.best_of`


class Times(NamedTuple):
    """What a policy that knows times of moves decides by."""

    times: PairTimes | Group
    columns: int
    rows: int


class Page(NamedTuple):
    """Arguments of all entries of a page."""

    play: Play
    decides: Tables | Times
    generators: np.ndarray  # (G, 4) uint64, states of agent/web/c/random.c
    keys: np.ndarray  # (3,) uint32, of the child that a generator begins as
    chance: np.ndarray  # (N,) uniform numbers, for start cells
    cameras: np.ndarray  # (B, CAMERA_SIZE) as they begin
    asked: np.ndarray  # (3,) a robot, and x and y in m of where it is put
    varied: np.ndarray  # (4,) uint32, references of what a world draws of motors; empty if nothing


class Playable(NamedTuple):
    """An episode at its start."""

    page: Page
    wasm: bytes
    image: Image


@kernel
def start(page: Page) -> int:
    """Put the robots on `play.cells`, with the motors that the world's uniform numbers make."""
    playing.start(page.play)
    calls, own = page.play.calls, page.play.varied.own
    for k in range(len(page.varied)):
        parameter, values = page.varied[k : k + 1], own[k]
        arguments = (calls.instances[0], parameter.ctypes.data, 1, values.ctypes.data, values.size)
        if exchange(calls.functions.set_float64, arguments) > FMI_WARNING:
            return -1
    return 0


@kernel
def follow(page: Page) -> int:
    """Simulate an RL step of a policy with tables; return the outcome's rank, −1 on a failure."""
    play, decides = page.play, page.decides
    playing.follow(decides.process, decides.best, play.moves.seen, play.wanted)
    return _simulate(play)


@kernel
def meet(page: Page) -> int:
    """Simulate an RL step of a pair that knows its times likewise."""
    play, decides = page.play, page.decides
    playing.meet(decides.times, decides.columns, decides.rows, play.moves.seen, play.wanted)
    return _simulate(play)


@kernel
def plan(page: Page) -> int:
    """Simulate an RL step of robots that plan likewise."""
    play, decides = page.play, page.decides
    playing.plan_all(decides.times, decides.columns, decides.rows, play.moves.seen, play.wanted)
    return _simulate(play)


@kernel
def _simulate(play: Play) -> int:
    begin_step(play)
    if advance(play, 0, len(play.noise)) < 0:
        return -1
    return end_step(play)


@kernel
def place(page: Page) -> int:
    """Put the robot that is asked for at rest where there is room; return whether there was."""
    play, robot = page.play, int(page.asked[0])
    state, x, y = play.state, page.asked[1], page.asked[2]
    radius_m = 0.5 * play.plant.pair.diameter
    if not (0.0 <= x < state.boards[0, 0] and 0.0 <= y < state.boards[0, 1]):
        return 0
    if _touches(x, y, radius_m * radius_m, state.obstacles[0]):
        return 0
    if _touches(x, y, 0.0, state.forbidden[robot]):
        return 0
    for other in range(play.plant.robots):
        away_x, away_y = state.bodies[X, other] - x, state.bodies[Y, other] - y
        if other != robot and away_x * away_x + away_y * away_y <= 4.0 * radius_m * radius_m:
            return 0
        if state.owners[other] != robot and _touches(x, y, 0.0, state.targets[other : other + 1]):
            return 0
    angle = heading(orientation_of(state.bodies[:, robot]))
    stand(state.bodies[:, robot], play.rules.height_m, x, y, angle)
    state.estimates[robot] = 0.0
    state.cameras[robot] = page.cameras[robot]
    state.shields[robot] = 0.0
    for k in range(3):
        state.estimates[robot, POSE + k] = (x, y, angle)[k]
    state.commands[robot, MODE] = HOLD
    play.moves.arrived[robot] = False
    play.moves.moving[robot] = True  # so that it arrives on its target
    rules.conclude(play.rules, state, 0, play.moves, False)
    return 1


def playable(policy: GreedyPolicy, setup: Setup, seed: int) -> Playable:
    """Return the episodes of a policy as a page plays them, with the draws of a seed's world.

    Raises:
        UserError: the policy has no kernel, or a compiler is missing.
    """
    scenario, config, fmu = setup
    policy.require_scenario(scenario)
    robots = scenario.robots
    motor = MotorFmu(fmu)
    varied = [motor.parameter(name, tunable=True) for name in ("K_T", "R", "J", "r")]
    batch = Batch(fmu, config, robots, 1, lanes=1 if robots == 1 else 2)
    play = new_play(batch, batch.begin(0, scenario, *draw_episode(scenario, seed, 0)))
    step, decides = _deciding(policy)
    children = 3 + robots * (
        config.robot.motors_count + 1
    )  # world, starts, motors, cameras, detours
    page = Page(
        play,
        decides,
        np.zeros((children, 4), dtype=np.uint64),
        np.zeros(3, dtype=np.uint32),
        np.zeros(robots),
        play.state.cameras.copy(),
        np.zeros(3),
        np.array(varied if config.world.motor_spread else [], dtype=np.uint32),
    )
    entries = {"start": "start", "step": step, "place": "place"}
    wasm = compiled({name: f"{__name__}:{kernel}" for name, kernel in entries.items()}, page)
    motors = batch.driver.motors.array
    assert motors is not None
    image = image_of(page, motors=np.frombuffer(motors.get_state(), dtype=np.uint8))
    batch.close()
    return Playable(page, wasm, image)


def _deciding(policy: GreedyPolicy) -> tuple[str, Tables | Times]:
    """Return the name of the kernel of an RL step, and what it decides by."""
    board = policy.config.scenario
    if isinstance(policy, Policy):
        return "follow", Tables(policy.process, best_of(policy.values))
    if isinstance(policy, PairPolicy):
        return "meet", Times(policy.times, board.columns, board.rows)
    if isinstance(policy, GroupPolicy):
        return "plan", Times(policy.group, board.columns, board.rows)
    raise UserError(
        f"the method {policy.config.method} has no kernel that a page could play; choose paper, "
        "moves, shortest, fastest or planned"
    )
