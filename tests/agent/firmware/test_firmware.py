"""The firmware's C in place of the Python: every action and every set point, in every bit."""

import ctypes
import json
import math
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import agent
from agent.deep.policy import NetworkPolicy
from agent.firmware.build import FLAGS, LIBRARY, MICROCONTROLLER, write_sources
from agent.firmware.constants import render_constants
from agent.mdp.config import ProcessConfig
from agent.mdp.readings import build_process
from agent.training.policy import Policy, PolicyConfig, Seed
from agent.training.settings import LearningConfig
from cosim.coupling.fmu import MotorFmu
from cosim.coupling.rl_step import decide
from cosim.coupling.signals import new_raw_samples, new_samples
from cosim.model.config import CoSimConfig
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_scenario
from cosim.onboard.features import Observation, distance_thresholds
from cosim.onboard.observing import cells_of, nearest_squared, observe
from cosim.onboard.steering import DIRECT, MODE, OMEGA_D, OMEGA_E
from cosim.physics.rotation import heading
from cosim.physics.trig import arctangent
from cosim.simulation.cosimulation import CoSimulation
from cosim.simulation.options import SimulationOptions, resolve
from cosim.simulation.simulate import draw_episode
from tests.references.native import compile_firmware

pytestmark = pytest.mark.long  # it compiles C for every case

MODES = (0.0, 1.0, 2.0, 3.0, 5.0)  # of cosim.onboard.steering, by those of the firmware
MOST_RAM = 64_000


class Robot(ctypes.Structure):
    """`Robot` of minirobot.h."""

    _fields_ = (
        ("mode", ctypes.c_int),
        ("goal", 2 * ctypes.c_double),
        ("direction", ctypes.c_int32),
        ("sense", ctypes.c_double),
        ("dither_phase", ctypes.c_double),
        ("dither_sign", ctypes.c_double),
        ("period", ctypes.c_uint32),
        ("moving_since", ctypes.c_uint32),
        ("squared", ctypes.c_int32),
        ("arrived", ctypes.c_bool),
    )


class Fleet:
    """The firmware of every robot of a board, each in a library of its own."""

    def __init__(self, folder: Path, robots: int) -> None:
        self.libraries, self.robots = [], [Robot() for _ in range(robots)]
        sources = [folder / name for name in LIBRARY]
        for number in range(1, robots + 1):
            out = folder / f"robot{number}.so"
            compile_firmware(folder, out, sources, number)
            library = ctypes.CDLL(str(out))
            numbers, pointer = ctypes.c_double, ctypes.c_void_p
            library.robot_decide.argtypes = (pointer, numbers, pointer)
            library.robot_steer.argtypes = (pointer, numbers, numbers, numbers, pointer)
            library.robot_decides.restype = ctypes.c_bool
            self.libraries.append(library)

    def start(self, positions: np.ndarray) -> None:
        for library, robot in zip(self.libraries, self.robots, strict=True):
            library.robot_start(ctypes.byref(robot), positions.ctypes)

    def decide(self, positions: np.ndarray, angles: np.ndarray) -> np.ndarray:
        for library, robot, angle in zip(self.libraries, self.robots, angles, strict=True):
            assert library.robot_decides(ctypes.byref(robot))
            library.robot_decide(ctypes.byref(robot), angle, positions.ctypes)
        return np.array([robot.direction for robot in self.robots])

    def steer(self, positions: np.ndarray, angles: np.ndarray) -> np.ndarray:
        set_points = np.empty((len(self.robots), 2))
        for k, (library, robot) in enumerate(zip(self.libraries, self.robots, strict=True)):
            where = (*positions[k].tolist(), angles[k])
            library.robot_steer(ctypes.byref(robot), *where, set_points[k].ctypes)
        return set_points


def poses(state, robots: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions and headings of a co-simulation's robots."""
    bodies = state.bodies[:, :robots]
    return bodies[:2].T.copy(), np.array([heading(tuple(q), True) for q in bodies[3:7].T])


class InPlace:
    """A driver whose robots the firmware steers, and a policy that is the firmware's."""

    def __init__(self, fleet: Fleet, simulation: CoSimulation) -> None:
        batch = simulation._batch
        self.fleet = fleet
        self.inner, self.state = batch._driver, batch.state
        self.motors = self.inner.motors
        batch._driver = self
        where, _ = poses(self.state, len(fleet.robots))
        fleet.start(where)

    def act(self, _: Observation) -> np.ndarray:
        return self.fleet.decide(*poses(self.state, len(self.fleet.robots)))

    def advance(self, plant, state, noise, samples, raw) -> None:
        robots, columns = len(self.fleet.robots), state.bodies.shape[1]
        one, none = new_samples(1, columns), new_raw_samples(0, columns)
        for period in range(len(noise)):
            where = poses(state, robots)
            set_points = self.fleet.steer(*where)
            state.commands[:robots, OMEGA_D : OMEGA_E + 1] = set_points
            state.commands[:robots, MODE] = DIRECT
            self.inner.advance(plant, state, noise[period : period + 1], one, none)
            for every, new in zip(samples, one, strict=True):
                every[period] = new[0]
            state.periods[state.periods > 0] = period + 1
            if not state.running.any():
                break
        state.commands[:robots, MODE] = [MODES[robot.mode] for robot in self.fleet.robots]


def drive(simulation, policy, observation):
    """Actions, set points, voltages and positions of an episode, and how it ended."""
    steps = []
    while not simulation.outcome:
        decision = decide(policy, observation)
        steps.append(simulation.advance(decision.action))
        observation = simulation.episode.observation
    kept = ("omega_des", "position", "voltage")
    signals = {n: np.concatenate([getattr(s.samples, n) for s in steps]) for n in kept}
    return np.array([s.action for s in steps]), signals, simulation.outcome


@pytest.fixture(scope="module")
def policy():
    return agent.train("2", method="paper", episodes=400_000)


def in_place(folder: Path, policy, seeds, starts=None, **options) -> list[str]:
    """Compare episodes of the firmware with those of the Python; how they ended."""
    scenario = policy.config.scenario
    _, config, fmu = resolve(SimulationOptions(portable=True, **options), scenario)
    write_sources(folder, render_constants(policy, config))
    fleet = Fleet(folder, scenario.robots)
    outcomes = []
    for seed in seeds:
        drawn, noise_seed = draw_episode(scenario, seed, 0)
        simulation = CoSimulation(scenario, fmu, config)
        observation = simulation.reset(starts or drawn, noise_seed)
        actions, signals, outcome = drive(simulation, policy, observation)
        observation = simulation.reset(starts or drawn, noise_seed)
        ours = InPlace(fleet, simulation)
        our_actions, our_signals, our_outcome = drive(simulation, ours, observation)
        simulation.close()
        assert (our_actions == actions).all()
        for name, values in signals.items():
            assert our_signals[name].tobytes() == values.tobytes(), name
        assert our_outcome == outcome
        outcomes.append(str(outcome))
    return outcomes


@pytest.mark.long
def test_a_whole_episode_has_the_bits_of_the_python_loop(policy, tmp_path):
    assert in_place(tmp_path, policy, [0], ((13, 21), (18, 10))) == ["success"]


@pytest.mark.slow
def test_more_episodes_have_the_bits_of_the_python_loop(policy, tmp_path):
    assert in_place(tmp_path / "stop", policy, range(4)).count("success") >= 2
    assert len(in_place(tmp_path / "through", policy, [0, 1], through=True)) == 2


def random_policy(scenario, features, rng) -> Policy:
    """Tables of few different values: most states have several best directions."""
    config = PolicyConfig(
        scenario, ProcessConfig(features=tuple(features)), LearningConfig(), Seed(0)
    )
    states = build_process(scenario, config.process).state_count
    q = rng.integers(3, size=(1, scenario.robots, states, 8)).astype(np.float32)
    visits = np.ones(q.shape[1:3], dtype=np.uint32)
    return Policy(config, q, visits, np.zeros(1, dtype=np.uint64), 0)


@pytest.mark.parametrize(
    ("name", "features"),
    [("1b", "xyh"), ("4-ring", "xydgb"), ("small", "xdgbhp")],
)
def test_decisions_are_those_of_the_policy(name, features, tmp_path):
    if name == "small":
        scenario = Scenario(
            "small", "", ((5, 5), (0, 0)), (((5, 0),), ((0, 5),)), 6, 6, zone=(2, 2, 3, 3)
        )
    else:
        scenario = find_scenario(name)
    rng = np.random.default_rng(3)
    policy = random_policy(scenario, features, rng)
    write_sources(tmp_path, render_constants(policy, CoSimConfig()))
    fleet = Fleet(tmp_path, scenario.robots)
    thresholds = distance_thresholds(scenario)
    targets, eighth = np.array(scenario.targets), math.pi / 4.0
    for _ in range(300):
        where = rng.random((2, scenario.robots, 2)) * scenario.size_m
        where[1] = (where[0] + rng.normal(0.0, 0.02, where[0].shape)).clip(
            0.0, np.nextafter(scenario.size_m, 0.0)
        )
        if any(
            c.tolist() in np.delete(targets, i, 0).tolist()
            for i, c in enumerate(cells_of(where[1], scenario.cell_m))
        ):
            continue  # at another's target robots wait
        angles = rng.uniform(-math.pi, math.pi, scenario.robots)
        angles[0] = (rng.integers(-8, 8) / 2.0) * eighth  # also between two directions
        before = nearest_squared(cells_of(where[0], scenario.cell_m))
        seen = observe(where[1], angles, scenario.cell_m, thresholds, before, targets)
        fleet.start(where[0])
        assert fleet.decide(where[1], angles).tolist() == policy.act(seen).action.tolist()


def test_moves_are_given_up_at_their_limit_whenever_they_began(tmp_path):
    policy = random_policy(find_scenario("1a"), "xy", np.random.default_rng(0))
    write_sources(tmp_path, render_constants(policy, CoSimConfig()))
    fleet, where = Fleet(tmp_path, 1), np.array([[0.155, 0.205]])
    fleet.start(where)
    for began in range(0, 300 * 2000, 2000):  # every RL step of ten minutes
        fleet.robots[0].mode = 0  # HOLD
        for later, since in ((0, 0), (38_000, 0), (40_000, 40_000)):
            fleet.robots[0].period = began + later
            fleet.decide(where, np.zeros(1))
            assert fleet.robots[0].moving_since == began + since


@pytest.mark.parametrize("second", [(0.2, -1e-9), (0.155, 0.185)])
def test_robots_wait_where_one_is_off_the_board_or_at_anothers_target(second, tmp_path):
    policy = random_policy(find_scenario("2"), "xydg", np.random.default_rng(0))
    write_sources(tmp_path, render_constants(policy, CoSimConfig()))
    fleet = Fleet(tmp_path, 2)
    fleet.start(np.array([[0.1, 0.29], [0.2, 0.1]]))
    fleet.decide(np.array([[0.1, 0.29], [0.2, 0.1]]), np.zeros(2))
    assert 0 not in [robot.mode for robot in fleet.robots]
    where = np.array([[0.1, 0.29], second])
    fleet.start(where)
    fleet.decide(where, np.zeros(2))
    assert [robot.mode for robot in fleet.robots] == [0, 0]
    assert not fleet.steer(where, np.zeros(2)).any()


@pytest.fixture(scope="module")
def library(tmp_path_factory) -> ctypes.CDLL:
    """The firmware of some policy."""
    folder = tmp_path_factory.mktemp("firmware")
    policy = random_policy(find_scenario("1a"), "x", np.random.default_rng(0))
    write_sources(folder, render_constants(policy, CoSimConfig()))
    loaded = Fleet(folder, 1).libraries[0]
    numbers = ctypes.c_double
    loaded.arctangent.argtypes, loaded.arctangent.restype = (numbers,), numbers
    loaded.speed_loop.argtypes = (ctypes.c_void_p, numbers, numbers)
    loaded.speed_loop.restype = numbers
    return loaded


@given(x=st.floats(-8.0, 8.0) | st.floats(allow_nan=False))
def test_arctangent_is_the_librarys_but_for_the_last_bit(library, x):
    ours, theirs = library.arctangent(x), math.atan(x)
    assert abs(ours - theirs) <= math.ulp(theirs)
    assert ours == arctangent(x) == -library.arctangent(-x)


def speeds(fmu, set_point, seconds, library=None) -> np.ndarray:
    """Speed of a motor every millisecond, under its own loop, or under the firmware's."""
    motor = MotorFmu(fmu, open_loop=library is not None).instantiate("motor", {})
    loop, found = ctypes.c_double(0.0), []
    for k in range(round(1e3 * seconds)):
        speed = found[-1] if found else 0.0
        if library is not None:
            value = library.speed_loop(ctypes.byref(loop), set_point, speed)
        else:
            value = set_point
        motor.set_inputs(np.array([value, 0.0, 0.0]), 100 * k, 1e-5)
        motor.step(100 * k, 100, 1e-5)
        found.append(float(motor.outputs(100 * (k + 1), 1e-5)[1]))
    motor.close()
    return np.array(found)


def test_sampled_speed_loop_does_what_the_motors_own_does(library, motor_fmu):
    for set_point in (1000.0, -500.0):
        own, sampled = (speeds(motor_fmu, set_point, 2.0, lib) for lib in (None, library))
        end = slice(-200, None)
        assert sampled[end].mean() == pytest.approx(own[end].mean(), abs=1.0)
        assert np.abs(sampled).max() < 1.02 * np.abs(own).max()  # nothing winds up


def test_sources_are_c99_and_call_nothing_but_the_compilers_runtime(tmp_path):
    policy = random_policy(find_scenario("2"), "xydgb", np.random.default_rng(0))
    write_sources(tmp_path, render_constants(policy, CoSimConfig()))
    command = [sys.executable, "-m", "ziglang", "cc", *MICROCONTROLLER, *FLAGS]
    strict = ("-Werror", "-pedantic", "-Wno-unused-command-line-argument")  # zig's own, with -S
    called, defined = set(), set()
    for name in LIBRARY:
        run = subprocess.run(
            [*command, *strict, "-S", tmp_path / name, "-o", tmp_path / "out.s"],
            capture_output=True,
            text=True,
            check=False,
        )
        assert run.returncode == 0, run.stderr
        assembly = (tmp_path / "out.s").read_text()
        called |= set(re.findall(r"^\s+bl?\s+(\w+)$", assembly, re.MULTILINE))
        defined |= set(re.findall(r"^(\w+):", assembly, re.MULTILINE))
    runtime = {name for name in called - defined if not name.startswith(".")}
    assert "__aeabi_dmul" in runtime
    assert all(re.match(r"__aeabi_(d|i2d|ui2d|memcpy)|memcpy", name) for name in runtime), runtime


def test_command_writes_sources_and_says_what_they_need(command, policy, tmp_path):
    policy.save(tmp_path / "policy.npz")
    line = ("--policy", tmp_path / "policy.npz", "--out", tmp_path / "c")
    run = command("firmware", *line, "--json")
    assert run.returncode == 0, run.stderr
    said = json.loads(run.stdout.splitlines()[-1])
    assert {Path(file) for file in said["files"]} == set((tmp_path / "c").iterdir())
    states = policy.process.state_count
    for number, size in enumerate(said["sizes"], 1):
        assert size["robot"] == number
        assert states < size["flash"] < states + 16_000
        assert 0 < size["ram"] + size["stack"] < MOST_RAM
    for wrong, reason in (
        (("--shield",), "--shield"),
        (("--time-limit", "9"), "--time-limit has no effect"),
    ):
        refused = command("firmware", *line, *wrong)
        assert (refused.returncode, len(refused.stderr.splitlines())) == (2, 1)
        assert reason in refused.stderr


def test_networks_are_refused(command, monkeypatch, tmp_path):
    network = NetworkPolicy.__new__(NetworkPolicy)
    object.__setattr__(network, "config", SimpleNamespace(algorithm="ddqn"))
    monkeypatch.setattr("agent.firmware.constants.load_policy", lambda _path: network)
    run = command("firmware", "--policy", "p.npz", "--out", tmp_path)
    assert run.returncode == 2
    assert "a policy by ddqn" in run.stderr
