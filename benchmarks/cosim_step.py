"""Measure the cost of a co-simulated second, next to other engines.

Compute-bound work is timed by the processor time of its one thread, and the best of several rounds
counts: other work on the machine can only make a round longer. Recording, which has threads of its
own, is timed by the wall clock. docs/performance.md explains what bounds the figures.
"""

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import mujoco
import numpy as np

from benchmarks.recording import overheads
from benchmarks.timing import best_s
from cosim.base.command import Checked, Count
from cosim.base.jit import kernel
from cosim.coupling.calls import do_step
from cosim.coupling.fmu import Addresses, MotorFmu
from cosim.fmi.abi import FMI_OK, exchange_3
from cosim.model.config import CoSimConfig
from cosim.model.params import SHIELD, STEERING, TABLE_I, TABLE_II, TIMING
from cosim.model.scenario import MAX_SIDE_CELLS, Scenario
from cosim.physics.body_state import standing_state
from cosim.physics.lanes import host_lanes
from cosim.simulation.batch import ROBOTS_TOGETHER, Batch
from fmus.build import cached_fmu
from tests.references.mjcf import robots_mjcf
from tests.references.prescribed import Drive, Rig, drive_wrench, rig, trace_body

SPEED = STEERING.forward_speed_rad_s
NORTH = 2
SHORT_S = 0.5  # simulated time of a round: short and many, so that some meet an idle machine


@dataclass(frozen=True, kw_only=True)
class Options(Checked):
    rounds: Count = 40
    """Rounds of every measurement; the best counts."""
    lanes: Literal[1, 2, 4, 8] | None = None
    """Bodies in a vector of the batch, by default as many as the processor has."""


def driving(
    robots: int,
    episodes: int = 1,
    *,
    fmu: Path | None = None,
    driver: str = "compiled",
    lanes: int | None = None,
    shield: bool = False,
    rl_step_s: float = SHORT_S,
) -> Callable[[], object]:
    """One RL step of episodes with robots on a lattice of 7 cm, all driving north with noise."""
    side = max(2, int(np.ceil(np.sqrt(robots))))
    cells = tuple((3 + 7 * (k % side), 3 + 7 * (k // side)) for k in range(robots))
    starts = tuple((cell,) for cell in cells)
    # A board that no robot comes to the end of, with targets there.
    targets = tuple((x, MAX_SIDE_CELLS - 1 - y) for x, y in cells)
    scenario = Scenario("lattice", "", targets, starts, columns=7 * side + 7, rows=MAX_SIDE_CELLS)
    timing = TIMING._replace(rl_step_s=rl_step_s, episode_limit_s=1e9)
    config = CoSimConfig(timing=timing, shield=SHIELD if shield else None)
    batch = Batch(fmu or cached_fmu(), config, robots, episodes, driver, lanes)
    batch.compile()
    for place in range(episodes):
        batch.begin(place, scenario, cells, np.random.SeedSequence(place))
    actions = dict.fromkeys(range(episodes), np.full(robots, NORTH))
    return lambda: batch.advance(actions)


def body_step_s(rounds: int, ticks: int = 50_000) -> float:
    """One robot and tick with motors at prescribed speed, without FMUs, in s."""
    constants = rig(TABLE_I, TABLE_II, TIMING.dt_s)
    drive = Drive(-SPEED, SPEED, 0.0, 1.0)
    state = standing_state(TABLE_I, 0.0, 0.0, 0.0)
    trace = np.empty((1, len(state)))
    trace_body(state, constants, drive, 1, trace)
    return best_s(rounds, lambda: trace_body(state, constants, drive, ticks, trace))[0] / ticks


@kernel
def forces_only(constants: Rig, drive: Drive, ticks: int) -> float:
    """Sum over ticks of what the motors do to the body, so that nothing is left out."""
    total = 0.0
    for tick in range(ticks):
        force, moment = drive_wrench(constants, drive, tick)
        total += force[0] + force[2] + moment[0] + moment[1] + moment[2]
    return total


def motor_forces_s(rounds: int, ticks: int = 50_000) -> float:
    """Forces of one robot's two motors at one tick, in s."""
    constants, drive = rig(TABLE_I, TABLE_II, TIMING.dt_s), Drive(-SPEED, SPEED, 0.0, 1.0)
    forces_only(constants, drive, 1)
    return best_s(rounds, lambda: forces_only(constants, drive, ticks))[0] / ticks


@kernel
def fmu_only(
    calls: Addresses, instance: int, references: np.ndarray, values: np.ndarray, first: int, n: int
) -> int:
    """Step an FMU n times and read its outputs every time; returns the worst status."""
    worst, where, size = 0, values.ctypes.data, values.size
    for tick in range(first, first + n):
        worst = max(worst, do_step(calls.do_step, instance, tick * 1e-5, 1e-5))
        arguments = (instance, references.ctypes.data, 3, where, size)
        status = exchange_3(calls.get_float64, arguments)
        worst = max(worst, status)
    return worst


def motor_step_s(path: Path, motors: int, rounds: int, ticks: int = 20_000) -> float:
    """Time of one motor and tick in s, of an instance with this number of motors at drive speed."""
    fmu = MotorFmu(path)
    motor = fmu.instantiate("benchmark", motors=motors)
    if fmu.arrays:
        motor.restart(np.ones(motors, dtype=np.int64))
    values = np.zeros(len(fmu.outputs) * motors)
    motor.set_inputs(np.repeat([SPEED, 0.0, 0.0], motors), 0, TIMING.dt_s)
    done = 0

    def run(count: int) -> None:
        nonlocal done
        assert fmu_only(motor.addresses, motor.instance, fmu.outputs, values, done, count) == FMI_OK
        done += count

    run(100_000)
    return best_s(rounds, lambda: run(ticks))[0] / ticks / motors


def mujoco_step_s(rounds: int, ticks: int = 5_000) -> float:
    """Two bodies on three feet each, without motors, in MuJoCo's own loop, in s."""
    text = robots_mjcf(TABLE_I, TABLE_II, [(0.0, 0.0), (0.1, 0.0)], TIMING.dt_s)
    engine: Any = mujoco  # its names come from a compiled module without stubs
    model = engine.MjModel.from_xml_string(text)
    data = engine.MjData(model)
    engine.mj_step(model, data, nstep=ticks)
    return best_s(rounds, lambda: engine.mj_step(model, data, nstep=ticks))[0] / ticks


def recording_cost(rounds: int) -> dict[str, float]:
    """Additional time of the default recording of 60 s, as shares of the time without; its size."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "episode.rrd"
        overhead, processor = overheads("default", rounds, 60.0, path)
        fmpy, fmpy_processor = overheads("default", rounds, 60.0, path, "fmpy")
        return {
            "recording_overhead": float(overhead),  # by the wall clock, where two cores are free
            "recording_overhead_processor": float(processor),
            "recording_overhead_fmpy": float(fmpy),
            "recording_overhead_processor_fmpy": float(fmpy_processor),
            "recording_megabytes": path.stat().st_size / 1e6,
        }


def measure(options: Options) -> dict[str, float]:
    """Return all figures.

    The scalar path has an FMU instance for every motor, and moves one body after the other. A pair
    is simulated as `minirobots run` does it, with recording off.
    """
    rounds, lanes = options.rounds, options.lanes or host_lanes()
    pairs = ROBOTS_TOGETHER // 2
    one_motor, all_motors = cached_fmu("VibrationMotor"), cached_fmu("VibrationMotors")
    reference_s = 0.02
    scalar_s, pair_s, batch_s, pair_fmpy_s, batch_fmpy_s, by_python_s, one_s, sixteen_s = best_s(
        rounds,
        driving(2, fmu=one_motor, lanes=1),
        driving(2),
        driving(2, pairs, lanes=lanes),
        driving(2, driver="fmpy"),
        driving(2, pairs, lanes=lanes, driver="fmpy"),
        driving(2, driver="reference", rl_step_s=reference_s),
        driving(1),
        driving(16),
    )
    robot_s = batch_s / (2 * pairs)
    tick = TIMING.dt_s / SHORT_S
    return {
        # robot-seconds that one core simulates in a second, in a batch of pairs
        "batch_robot_seconds_per_s": SHORT_S / robot_s,
        "ratio_batch_to_scalar": scalar_s / 2 / robot_s,
        "realtime_factor": SHORT_S / pair_s,
        "ratio_episode_to_scalar": scalar_s / pair_s,
        "lanes": lanes,
        "realtime_factor_fmpy": SHORT_S / pair_fmpy_s,
        "ratio_fmpy": pair_fmpy_s / pair_s,
        "ratio_fmpy_batch": batch_fmpy_s / batch_s,
        "ratio_to_reference": by_python_s / reference_s * SHORT_S / pair_s,
        "ratio_to_mujoco": mujoco_step_s(rounds) / (tick * pair_s),
        "tick_ns": 1e9 * tick * pair_s,  # of a pair with its four motors
        "scalar_tick_ns": 1e9 * tick * scalar_s,
        "batch_robot_tick_ns": 1e9 * tick * robot_s,  # of a robot with its two motors
        # of a motor: fmi3DoStep, and fmi3GetFloat64 of three outputs
        "batch_motor_step_ns": 1e9 * motor_step_s(all_motors, 4 * pairs, rounds),
        "fmu_step_ns": 1e9 * motor_step_s(one_motor, 1, rounds),
        "body_step_ns": 1e9 * body_step_s(rounds),  # on the scalar path, with its motors' forces
        "motor_forces_ns": 1e9 * motor_forces_s(rounds),
        **recording_cost(max(3, rounds // 4)),
        "cost_per_robot_16_to_1": sixteen_s / 16 / one_s,
    }
