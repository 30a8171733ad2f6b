"""Test identification on machines with known parameters: truth by co-simulation.

A machine is drawn, driven by the sequence of `cosim.machine.identification.excitation` with its
motor FMUs and speed noise, seen by a camera for 60 s, and identified from nothing but that. What
has been identified is kept in --out: the same command resumes.
"""

from functools import cache
from pathlib import Path
from typing import Any

import joblib
import msgspec
import numpy as np

from cosim.base.command import workers
from cosim.base.errors import UserError
from cosim.base.progress import progress_bars
from cosim.base.reached_code import code_digest
from cosim.base.reading import Kind, read_json
from cosim.base.storage import write_json
from cosim.coupling.fmu import MotorFmu
from cosim.machine.identification.excitation import FRAME_RATE_HZ, HOLD_S, SEQUENCE
from cosim.machine.identification.fit import QUANTILE, fit
from cosim.machine.identification.parameters import PARAMETERS
from cosim.machine.identification.simulated import Simulated, simulated
from cosim.model.config import CoSimConfig
from fmus.build import cached_fmu
from minirobots.options import CommandOptions, Count, Folder, Jobs, Seed
from tests.references.machines import draw_machine, observed

RELATIVE = ("mu", "com_height_m", "foot_radius_m", "motor_d", "motor_e")  # errors in per cent
_KIND = Kind("result of a machine", "delete it", UserError)


class Options(CommandOptions):
    machines: Count = 40
    """Machines, drawn at random."""
    seed: Seed = 0
    jobs: Jobs = -1
    out: Folder = Path("runs/identification")
    """Folder of results."""


class MachineFound(msgspec.Struct, frozen=True):
    """Identified parameters of a machine, in the order of the parameters, in SI units."""

    truth: list[float]
    values: list[float]
    deviations: list[float]


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


def measure(options: Options) -> dict[str, Any]:
    machines, seed = options.machines, options.seed
    folder = options.out / code_digest(__name__)
    files = {number: folder / f"{seed}-{number}.json" for number in range(machines)}
    missing = [number for number, file in files.items() if not file.exists()]
    tasks = (joblib.delayed(_identify)(number, seed) for number in missing)
    with progress_bars() as progress:
        done = machines - len(missing)
        progress("identifying machines", done, machines)
        parallel = joblib.Parallel(workers(options.jobs), return_as="generator_unordered")
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
