"""What a co-simulated second costs, and beside what.

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

from benchmarks.prescribed import Drive, Rig, drive_wrench, rig, trace_body
from benchmarks.recording import overheads
from benchmarks.references.mjcf import robots_mjcf
from cosim.base.config import CoSimConfig
from cosim.base.jit import kernel
from cosim.base.params import STEERING, TABLE_I, TABLE_II, TIMING
from cosim.base.scenario import Scenario
from cosim.coupling.calls import FMI_OK, do_step, exchange_float64
from cosim.coupling.fmu import Addresses, MotorFmu
from cosim.navigation.batch import CoSimulation
from cosim.physics.body import standing_state
from fmus.build import cached_fmu

SPEED = STEERING.forward_speed_rad_s
NORTH = 2
SHORT_S = 0.5  # simulated time of a round: short and many, so that some meet an idle machine


@dataclass(frozen=True)
class Options:
    """Measure the co-simulation's speed and print ratios from one run."""

    rounds: int = 40
    """Rounds of every measurement; the best counts."""
    json: bool = False
    """Print one JSON object as the last line."""


@dataclass(frozen=True)
class StepTimes:
    """Results; names as in the JSON output.

    Attributes:
        realtime_factor: two robots, four motor FMUs, compiled driver, recording off.
        ratio_to_reference: compiled driver to the driver through fmpy's Python classes.
        ratio_to_mujoco: MuJoCo's time for two bodies without motors to ours with motors.
        body_step_ns: one robot and tick, motor forces at prescribed speed included.
        motor_forces_ns: the share of the two motors' forces in it (sines, mostly).
        fmu_step_ns: one FMU and tick: fmi3DoStep, and fmi3GetFloat64 of three outputs.
        tick_ns: two robots and four FMUs.
        recording_overhead: additional wall-clock time of the default recording, as a share.
        cost_per_robot_16_to_1: time per robot with sixteen robots over that with one.
    """

    realtime_factor: float
    ratio_to_reference: float
    ratio_to_mujoco: float
    body_step_ns: float
    motor_forces_ns: float
    fmu_step_ns: float
    tick_ns: float
    recording_overhead: float
    cost_per_robot_16_to_1: float


def best_s(
    work: Callable[[], object], rounds: int, clock: Callable[[], float] = time.thread_time
) -> float:
    """Shortest time of some calls by the given clock, in s."""
    times = []
    for _ in range(rounds):
        began = clock()
        work()
        times.append(clock() - began)
    return min(times)


def driving(robots: int, driver: str = "compiled", rl_step_s: float = SHORT_S) -> CoSimulation:
    """Robots on a lattice of 7 cm, about to drive."""
    side = max(2, int(np.ceil(np.sqrt(robots))))
    cells = [(3 + 7 * (k % side), 3 + 7 * (k // side)) for k in range(robots)]
    board = 7 * side + 7
    scenario = Scenario(
        "lattice", "", tuple(cells), tuple((c,) for c in cells), columns=board, rows=board
    )
    config = CoSimConfig(timing=TIMING._replace(rl_step_s=rl_step_s, episode_limit_s=1e9))
    system = CoSimulation(scenario, cached_fmu(), config, driver)
    system.compile()
    system.reset(tuple(cells), np.random.SeedSequence(0))
    return system


def advance_s(system: CoSimulation, rounds: int) -> float:
    """Best time of one RL step in which every robot drives."""
    action = np.full(system.scenario.robots, NORTH)
    return best_s(lambda: system.advance(action), rounds)


def body_step_s(rounds: int, ticks: int = 50_000) -> float:
    """One robot and tick with motors at prescribed speed, without FMUs, in s."""
    constants = rig(TABLE_I, TABLE_II, TIMING.dt_s)
    drive = Drive(-SPEED, SPEED, 0.0, 1.0)
    state = standing_state(TABLE_I, 0.0, 0.0, 0.0)
    trace = np.empty((1, len(state)))
    trace_body(state, constants, drive, 1, trace)
    return best_s(lambda: trace_body(state, constants, drive, ticks, trace), rounds) / ticks


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
    return best_s(lambda: forces_only(constants, drive, ticks), rounds) / ticks


@kernel
def fmu_only(
    calls: Addresses, instance: int, references: np.ndarray, values: np.ndarray, first: int, n: int
) -> int:
    """Step one FMU n times and read its outputs every time; returns the worst status."""
    worst = 0
    for tick in range(first, first + n):
        worst = max(worst, do_step(calls.do_step, instance, tick * 1e-5, 1e-5))
        status = exchange_float64(
            calls.get_float64, instance, references.ctypes.data, 3, values.ctypes.data
        )
        worst = max(worst, status)
    return worst


def fmu_step_s(rounds: int, ticks: int = 50_000) -> float:
    """One FMU at drive speed, one tick, in s."""
    fmu = MotorFmu(cached_fmu("VibrationMotor"))
    motor, values = fmu.instantiate("benchmark"), np.zeros(len(fmu.outputs))
    motor.set_inputs(np.array([SPEED, 0.0, 0.0]), 0, TIMING.dt_s)
    done = 0

    def run(count: int) -> None:
        nonlocal done
        assert fmu_only(motor.addresses, motor.instance, fmu.outputs, values, done, count) == FMI_OK
        done += count

    run(100_000)
    return best_s(lambda: run(ticks), rounds) / ticks


def mujoco_step_s(rounds: int, ticks: int = 5_000) -> float:
    """Two bodies on three feet each, without motors, in MuJoCo's own loop, in s."""
    text = robots_mjcf(TABLE_I, TABLE_II, [(0.0, 0.0), (0.1, 0.0)], TIMING.dt_s)
    engine: Any = mujoco  # its names come from a compiled module without stubs
    model = engine.MjModel.from_xml_string(text)
    data = engine.MjData(model)
    engine.mj_step(model, data, nstep=ticks)
    return best_s(lambda: engine.mj_step(model, data, nstep=ticks), rounds) / ticks


def recording_overhead(rounds: int) -> float:
    """Additional time of the default recording of 60 s, as a share of the time without."""
    with tempfile.TemporaryDirectory() as folder:
        return float(overheads("default", rounds, 60.0, Path(folder) / "episode.rrd")[0])


def measure(rounds: int) -> dict[str, float]:
    """All figures."""
    pair_s = advance_s(driving(2), rounds)
    reference_step_s = 0.02
    reference = driving(2, "reference", reference_step_s)
    reference_factor = reference_step_s / advance_s(reference, rounds)
    one_s, sixteen_s = (advance_s(driving(n), rounds) / n for n in (1, 16))
    factor = SHORT_S / pair_s
    tick_s = TIMING.dt_s / factor
    return asdict(
        StepTimes(
            realtime_factor=factor,
            ratio_to_reference=factor / reference_factor,
            ratio_to_mujoco=mujoco_step_s(rounds) / tick_s,
            body_step_ns=1e9 * body_step_s(rounds),
            motor_forces_ns=1e9 * motor_forces_s(rounds),
            fmu_step_ns=1e9 * fmu_step_s(rounds),
            tick_ns=1e9 * tick_s,
            recording_overhead=recording_overhead(max(3, rounds // 10)),
            cost_per_robot_16_to_1=sixteen_s / one_s,
        )
    )


def show(found: dict[str, float]) -> None:
    """Print the figures."""
    for name, value in found.items():
        print(f"{name:24} {value:8.3g}")


if __name__ == "__main__":
    from benchmarks.__main__ import run_alone

    run_alone(__file__)
