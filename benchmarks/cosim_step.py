"""Measure the cost of a co-simulated second, next to other engines.

All figures come from one run of this script. Compute-bound work is timed by the processor time of
its one thread, and the best of several rounds counts: other work on the machine can only make a
round longer. Recording, which has threads of its own, is timed by the wall clock.
docs/performance.md explains what bounds the figures.
"""

import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from benchmarks.recording import overheads
from benchmarks.references.mjcf import robots_mjcf
from benchmarks.references.prescribed import Drive, Rig, drive_wrench, rig, trace_body
from cosim.base.jit import kernel
from cosim.coupling.calls import do_step
from cosim.coupling.fmu import Addresses, MotorFmu
from cosim.fmi.abi import FMI_OK, exchange_3
from cosim.model.config import CoSimConfig
from cosim.model.params import STEERING, TABLE_I, TABLE_II, TIMING
from cosim.model.scenario import MAX_SIDE_CELLS, Scenario
from cosim.physics.body_state import standing_state
from cosim.physics.lanes import host_lanes
from cosim.simulation.batch import ROBOTS_TOGETHER, Batch
from fmus.build import cached_fmu

SPEED = STEERING.forward_speed_rad_s
NORTH = 2
SHORT_S = 0.5  # simulated time of a round: short and many, so that some meet an idle machine


@dataclass(frozen=True)
class StepTimes:
    """Results; names as in the JSON output.

    Attributes:
        batch_robot_seconds_per_s: robot-seconds that one core simulates in a second, in a batch of
            pairs as `cosim.simulation.tasks` makes them.
        ratio_batch_to_scalar: that to one pair on the scalar path: an FMU instance for every motor,
            one body after the other.
        realtime_factor: one pair as `cosim.run` simulates it, recording off.
        ratio_episode_to_scalar: that to the scalar path.
        lanes: bodies in a vector of the batch.
        realtime_factor_fmpy: one pair whose FMU fmpy steps, once per control period.
        ratio_fmpy: time of that to one of the compiled driver.
        ratio_fmpy_batch: the same of a batch.
        ratio_to_reference: one pair to the driver through fmpy's Python classes.
        ratio_to_mujoco: MuJoCo's time for two bodies without motors to that of one pair.
        tick_ns: one pair with its four motors.
        scalar_tick_ns: the same on the scalar path.
        batch_robot_tick_ns: a robot of the batch with its two motors.
        batch_motor_step_ns: a motor in a call to as many as the batch has: fmi3DoStep, and
            fmi3GetFloat64 of three outputs.
        fmu_step_ns: the same of an instance of one motor.
        body_step_ns: one robot on the scalar path, motor forces at prescribed speed included.
        motor_forces_ns: the share of the two motors' forces in it (sines, mostly).
        recording_overhead: additional wall-clock time of the default recording, as a share.
        cost_per_robot_16_to_1: time per robot with sixteen robots over that with one.
    """

    batch_robot_seconds_per_s: float
    ratio_batch_to_scalar: float
    realtime_factor: float
    ratio_episode_to_scalar: float
    lanes: int
    realtime_factor_fmpy: float
    ratio_fmpy: float
    ratio_fmpy_batch: float
    ratio_to_reference: float
    ratio_to_mujoco: float
    tick_ns: float
    scalar_tick_ns: float
    batch_robot_tick_ns: float
    batch_motor_step_ns: float
    fmu_step_ns: float
    body_step_ns: float
    motor_forces_ns: float
    recording_overhead: float
    cost_per_robot_16_to_1: float


def best_s(rounds: int, *works: Callable[[], object]) -> list[float]:
    """Shortest processor time of each in s; they take turns, so that all meet the same machine."""
    times = []
    for _ in range(rounds):
        for work in works:
            began = time.thread_time()
            work()
            times.append(time.thread_time() - began)
    return [min(times[k :: len(works)]) for k in range(len(works))]


def driving(
    robots: int,
    episodes: int = 1,
    *,
    fmu: Path | None = None,
    driver: str = "compiled",
    lanes: int | None = None,
    rl_step_s: float = SHORT_S,
) -> Callable[[], object]:
    """One RL step of episodes with robots on a lattice of 7 cm, all driving north with noise."""
    side = max(2, int(np.ceil(np.sqrt(robots))))
    cells = tuple((3 + 7 * (k % side), 3 + 7 * (k // side)) for k in range(robots))
    starts = tuple((cell,) for cell in cells)
    # A board that no robot comes to the end of, with targets there.
    targets = tuple((x, MAX_SIDE_CELLS - 1 - y) for x, y in cells)
    scenario = Scenario("lattice", "", targets, starts, columns=7 * side + 7, rows=MAX_SIDE_CELLS)
    config = CoSimConfig(timing=TIMING._replace(rl_step_s=rl_step_s, episode_limit_s=1e9))
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


def recording_overhead(rounds: int) -> float:
    """Additional time of the default recording of 60 s, as a share of the time without."""
    with tempfile.TemporaryDirectory() as folder:
        return float(overheads("default", rounds, 60.0, Path(folder) / "episode.rrd")[0])


def measure(rounds: int, lanes: int | None) -> dict[str, float]:
    """All figures.

    Args:
        rounds: of every measurement.
        lanes: of the batch, by default what the processor has.
    """
    lanes = lanes or host_lanes()
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
    return asdict(
        StepTimes(
            batch_robot_seconds_per_s=SHORT_S / robot_s,
            ratio_batch_to_scalar=scalar_s / 2 / robot_s,
            realtime_factor=SHORT_S / pair_s,
            ratio_episode_to_scalar=scalar_s / pair_s,
            lanes=lanes,
            realtime_factor_fmpy=SHORT_S / pair_fmpy_s,
            ratio_fmpy=pair_fmpy_s / pair_s,
            ratio_fmpy_batch=batch_fmpy_s / batch_s,
            ratio_to_reference=by_python_s / reference_s * SHORT_S / pair_s,
            ratio_to_mujoco=mujoco_step_s(rounds) / (tick * pair_s),
            tick_ns=1e9 * tick * pair_s,
            scalar_tick_ns=1e9 * tick * scalar_s,
            batch_robot_tick_ns=1e9 * tick * robot_s,
            batch_motor_step_ns=1e9 * motor_step_s(all_motors, 4 * pairs, rounds),
            fmu_step_ns=1e9 * motor_step_s(one_motor, 1, rounds),
            body_step_ns=1e9 * body_step_s(rounds),
            motor_forces_ns=1e9 * motor_forces_s(rounds),
            recording_overhead=recording_overhead(max(3, rounds // 10)),
            cost_per_robot_16_to_1=sixteen_s / 16 / one_s,
        )
    )


def show(found: dict[str, float]) -> None:
    """Print the figures."""
    for name, value in found.items():
        print(f"{name:26} {value:8.3g}")
