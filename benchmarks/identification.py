"""Test identification on machines with known parameters: truth by co-simulation.

A machine is drawn, driven by the sequence of `cosim.machine.identification.excitation` with its
motor FMUs and speed noise, seen by a camera, and identified from nothing but that.
"""

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import joblib
import msgspec
import numpy as np

from cosim.base.command import workers
from cosim.base.errors import UserError
from cosim.base.progress import progress_bars
from cosim.base.reached_code import code_digest
from cosim.base.reading import Kind, read_json
from cosim.base.storage import write_json
from cosim.calibration.trial import Trial, heading_angles
from cosim.coupling.fmu import MotorFmu
from cosim.machine.identification.excitation import FRAME_RATE_HZ, HOLD_S, SEQUENCE
from cosim.machine.identification.fit import QUANTILE, fit
from cosim.machine.identification.parameters import PARAMETERS, machine
from cosim.machine.identification.simulated import Simulated, simulated
from cosim.machine.identification.track import SeenTrack
from cosim.model.config import CoSimConfig
from cosim.model.params import TABLE_II, MotorParams
from cosim.model.world import Sensor, World, draw_world
from cosim.onboard.camera import draw_sight
from cosim.onboard.steering import DIRECT, MODE, OMEGA_D, OMEGA_E
from fmus.build import cached_fmu
from minirobots.options import CommandOptions, Count, Folder, Jobs, Seed

CAMERA = Sensor(FRAME_RATE_HZ, 50.0, 0.5, 1.0)
MOTOR_SPREAD = 0.1
# Uniform between these, SI units; motors are drawn as in `cosim.model.world`.
RANGES = ((0.1, 0.3), (0.01, 0.02), (-1e-3, 1e-3), (-1e-3, 1e-3), (0.02, 0.024))
RELATIVE = ("mu", "com_height_m", "foot_radius_m", "motor_d", "motor_e")  # errors in per cent
_KIND = Kind("result of a machine", "delete it", UserError)


@dataclass(frozen=True, kw_only=True)
class Options(CommandOptions):
    """Identify machines that are known, from 60 s of what a camera sees of them.

    Errors and intervals of every parameter. What has been identified is kept in --out: the same
    command resumes.
    """

    machines: Count = 40
    """Machines, drawn at random."""
    seed: Seed = 0
    jobs: Jobs = -1
    out: Folder = Path("runs/identification")
    """Folder of results."""


class Truth(NamedTuple):
    """A machine that was drawn.

    Attributes:
        values: (8,), see `cosim.machine.identification.parameters`.
        motors: D and E.
    """

    values: np.ndarray
    motors: tuple[MotorParams, MotorParams]


class MachineFound(msgspec.Struct, frozen=True):
    """Identified parameters of a machine; values in the order of the parameters, SI units."""

    truth: list[float]
    values: list[float]
    deviations: list[float]


def draw_machine(seed: np.random.SeedSequence) -> Truth:
    """A machine at random."""
    rng = np.random.default_rng(seed)
    (motors,) = draw_world(World(motor_spread=MOTOR_SPREAD), TABLE_II, 1, seed).motors
    drawn = [rng.uniform(low, high) for low, high in RANGES]
    factors = [motor.r / TABLE_II.r for motor in motors]
    return Truth(np.array([*drawn, *factors, 1e-3 * CAMERA.delay_ms]), motors)


def observed(
    truth: Truth,
    seed: np.random.SeedSequence,
    sequence: tuple[tuple[float, float], ...] = SEQUENCE,
    camera: Sensor = CAMERA,
) -> SeenTrack:
    """The track of a machine: co-simulated with its motors and speed noise, and seen by a camera.

    Args:
        truth: the machine.
        seed: of the speed noise and the camera's.
        sequence: set points of both motors, each held for HOLD_S.
        camera: that looks.
    """
    config = replace(CoSimConfig(), robot=machine(truth.values).robot)
    period_s = config.timing.control_period_s
    with Trial(MotorFmu(cached_fmu()), config, np.zeros(1), seed, motors=[truth.motors]) as trial:
        trial.commands[:, MODE] = DIRECT
        places, turned = [trial.bodies[:2].T - trial.origins_m], [trial.bodies[3:7].T]
        for omega_d, omega_e in sequence:
            trial.commands[:, OMEGA_D], trial.commands[:, OMEGA_E] = omega_d, omega_e
            samples = trial.advance(round(HOLD_S / period_s))
            places.append(samples.position[:, 0, :2] - trial.origins_m)
            turned.append(samples.quaternion[:, 0])
    angles = heading_angles(np.concatenate(turned))
    cosine, sine = np.cos(angles), np.sin(angles)
    x, y = truth.values[2:4]  # of the centre of mass; the camera sees the axis
    axis = np.concatenate(places) - np.column_stack([cosine * x - sine * y, sine * x + cosine * y])
    frames = round(len(sequence) * HOLD_S * camera.rate_hz) + 1
    times = np.arange(frames) / camera.rate_hz
    looks = period_s * np.arange(len(angles))
    taken = times - truth.values[-1]
    poses = np.column_stack([np.interp(taken, looks, s) for s in (*axis.T, angles)])
    poses += draw_sight(camera, np.random.default_rng(seed), frames)[:, :3]
    steps = np.minimum((times / HOLD_S + 1e-9).astype(int), len(sequence) - 1)
    return SeenTrack(times, poses, np.array(sequence)[steps])


@cache
def _simulated() -> Simulated:
    """Simulations of the sequence, the same of every machine."""
    config = CoSimConfig()
    period_s = config.timing.control_period_s
    set_points = np.repeat(np.array(SEQUENCE), round(HOLD_S / period_s), axis=0)
    frames = round(len(SEQUENCE) * HOLD_S * FRAME_RATE_HZ) + 1
    times = np.arange(frames) / FRAME_RATE_HZ
    return simulated(set_points, times, MotorFmu(cached_fmu()), config)


def _identify(number: int, seed: int) -> tuple[int, MachineFound]:
    child = np.random.SeedSequence(seed, spawn_key=(number,))
    truth = draw_machine(child)
    found = fit(observed(truth, child), _simulated())
    return number, MachineFound(
        truth.values.tolist(), found.values.tolist(), found.deviations.tolist()
    )


def measure(machines: int, seed: int, jobs: int, out: Path) -> dict[str, Any]:
    """Identify this number of machines, those found in the folder included.

    Args:
        machines: how many.
        seed: of machines, noise and camera.
        jobs: processes.
        out: folder of results, one file for each machine.
    """
    folder = out / code_digest(__name__)
    files = {number: folder / f"{seed}-{number}.json" for number in range(machines)}
    missing = [number for number, file in files.items() if not file.exists()]
    tasks = (joblib.delayed(_identify)(number, seed) for number in missing)
    with progress_bars() as progress:
        done = machines - len(missing)
        progress("identifying machines", done, machines)
        parallel = joblib.Parallel(workers(jobs), return_as="generator_unordered")
        for number, found in parallel(tasks):  # pyright: ignore[reportGeneralTypeIssues]
            write_json(files[number], found)
            done += 1
            progress("identifying machines", done, machines)
    rows = [read_json(file, _KIND, MachineFound) for file in files.values()]
    return {"machines": machines, "seed": seed, "results": str(folder)} | summary(rows)


def summary(rows: list[MachineFound]) -> dict[str, Any]:
    """Median errors and coverage by parameter, and over all."""
    truth, values, deviations = (
        np.array([getattr(row, name) for row in rows]) for name in MachineFound.__struct_fields__
    )
    errors = np.abs(values - truth)
    inside = errors <= QUANTILE * deviations
    table = {}
    for k, parameter in enumerate(PARAMETERS):
        relative = parameter.name in RELATIVE
        scale = 100.0 / np.abs(truth[:, k]) if relative else np.full(len(rows), parameter.scale)
        error = scale * errors[:, k]
        table[parameter.name] = {
            "unit": "%" if relative else parameter.unit,
            "median_error": float(np.median(error)),
            "largest_error": float(error.max()),
            "median_half_interval": float(np.median(QUANTILE * scale * deviations[:, k])),
            "covered": int(inside[:, k].sum()),
        }
    return {"covered_share": float(inside.mean()), "parameters": table}


def show(found: dict[str, Any]) -> None:
    """Print the table."""
    print("parameter       median error    largest  half interval  truth in the 95 % interval")
    for name, row in found["parameters"].items():
        print(
            f"{name:15}{row['median_error']:10.2f} {row['unit']:2}{row['largest_error']:10.2f}"
            f"{row['median_half_interval']:15.2f}{row['covered']:10d} of {found['machines']}"
        )
    print(f"in all: {found['covered_share']:.1%}; results in {found['results']}/")
