"""Measure how well parameters are identified from tracks of another engine, MuJoCo.

Robots drawn around those of several machines are driven with speed noise and seen by a camera,
in MuJoCo, whose contacts are soft, and by the kernels of the fit, as a reference: there with motor
speeds that are drawn too, and every second robot by a camera without noise. Errors are in percent
of the drawn value; `covered` counts intervals of 95 % that have it, of those that are reported, and
`doubted` the tracks for which there are none.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np

from benchmarks.machines import machine as layout
from cosim.base.command import Checked, Count
from cosim.fmi.motor import MotorFmu
from cosim.machine.identification.fit import QUANTILE, UNKNOWN, fit
from cosim.machine.identification.simulated import (
    LOOKS_S,
    machine,
    motor_speeds,
    parameters_of,
    simulated_drive,
    tracks,
    usual_values,
)
from cosim.machine.identification.track import FRAME_RATE_HZ, SeenTrack, excitation
from cosim.model.config import CoSimConfig
from cosim.model.preset import find_preset
from cosim.model.world import Sensor
from cosim.onboard.camera import draw_sight
from fmus.build import cached_fmu
from tests.references.mjcf import mujoco_track

MACHINES = {
    "paper": find_preset("paper").config(),
    "kilobot": find_preset("kilobot").config(),
    "2 motors, 4 feet": layout(2, 4),
    "3 motors, 3 feet": layout(3, 3),
}
HOLD_S = 1.5  # of the set points, half as long as for a user's robot
DRAWN = 0.3  # standard deviation of drawn parameters, in that assumed by the fit
CAMERA = Sensor(FRAME_RATE_HZ, 50.0, 0.5, 1.0)
ENGINES: dict[str, Callable[..., np.ndarray]] = {
    "MuJoCo": mujoco_track,
    "own": lambda robot, *given: tracks([robot], *given)[:, 0],
}
SHARES = (0.5, 0.85)  # of the speed at which a motor lifts the robot, of drawn motor speeds
STANDING = 0.35  # probability that a motor stands
GAP_RAD_S = 100.0  # that drawn speeds differ by at least


@dataclass(frozen=True, kw_only=True)
class Options(Checked):
    robots: Count = 3
    """Robots of every machine."""
    engines: tuple[Literal["MuJoCo", "own"], ...] = ("MuJoCo", "own")
    """What simulates the tracks."""


def drawn_speeds(config: CoSimConfig, seed: int, holds: int) -> np.ndarray:
    """Return set points (holds, M) in rad/s that keep the rules of docs/own.md."""
    rng, top = np.random.default_rng(seed), np.abs(excitation(config)).max(axis=0) / 0.8
    rows: list[np.ndarray] = []
    while len(rows) < holds:
        row = top * rng.uniform(*SHARES, len(top)) * rng.choice([-1.0, 1.0], len(top))
        row[rng.random(len(top)) < STANDING] = 0.0
        running = np.sort(np.abs(row[row != 0.0]))
        if len(running) and (np.diff(running) >= GAP_RAD_S).all():
            rows.append(row.round(1))
    return np.array(rows)


def observed(
    engine: Callable[..., np.ndarray],
    values: np.ndarray,
    seed: int,
    config: CoSimConfig,
    sequence: np.ndarray,
    *,
    noisy: bool,
) -> SeenTrack:
    """Return the track of a robot with some values and set points."""
    period_s, delay_s = config.timing.control_period_s, 1e-3 * CAMERA.delay_ms
    set_points = np.repeat(sequence, round(HOLD_S / period_s), axis=0)
    noise = np.random.SeedSequence(seed, spawn_key=(1,))  # none that the fit uses
    speeds = motor_speeds(set_points, MotorFmu(cached_fmu()), config, noise)
    every = round(LOOKS_S / period_s)
    given = speeds, config.ticks_per_period, config.timing.dt_s, every
    poses = engine(machine(values, config.robot, config.motor), *given)
    times = np.arange(round(len(sequence) * HOLD_S * CAMERA.rate_hz) + 1) / CAMERA.rate_hz
    looks = LOOKS_S * np.arange(len(poses))
    seen = np.column_stack([np.interp(times - delay_s, looks, signal) for signal in poses.T])
    seen += noisy * draw_sight(CAMERA, np.random.default_rng(seed), len(times))[:, :3]
    rows = np.minimum((times / HOLD_S + 1e-9).astype(int), len(sequence) - 1)
    return SeenTrack(times, seen, sequence[rows])


class Identified(NamedTuple):
    """What is found of one robot, K parameters."""

    error_percent: np.ndarray  # (K,)
    inside: np.ndarray  # (K,) whether its interval has the value; NaN without an interval
    doubted: bool


def identified(config: CoSimConfig, engine: str, seed: int) -> Identified:
    """Identify a robot that is drawn around a machine."""
    own = engine == "own"
    spreads = np.array([p.spread for p in parameters_of(config.robot)])
    drawn = DRAWN * np.random.default_rng(seed).standard_normal(len(spreads))
    truth = usual_values(config.robot) + spreads * drawn
    truth[-1] = 1e-3 * CAMERA.delay_ms
    usual = np.array(list(dict.fromkeys(excitation(config))))
    sequence = drawn_speeds(config, seed, len(usual)) if own else usual
    noisy = not own or seed % 2 == 0
    track = observed(ENGINES[engine], truth, seed, config, sequence, noisy=noisy)
    found = fit(track, simulated_drive(track, config, cached_fmu()))
    inside = np.abs(found.values - truth) < QUANTILE * found.deviations
    known = (found.deviations < UNKNOWN * spreads) & (not found.doubts)
    error_percent = 100.0 * (found.values - truth) / truth
    return Identified(error_percent, np.where(known, inside, np.nan), bool(found.doubts))


def measure(options: Options) -> dict[str, Any]:
    rows = []
    for name, config in MACHINES.items():
        parameters = parameters_of(config.robot)
        kinds = {
            "mu": [p.name == "mu" for p in parameters],
            "all": [True] * len(parameters),
            "unbalance": [p.name.startswith("motor_") for p in parameters],
        }
        for engine in options.engines:
            found = [identified(config, engine, seed) for seed in range(options.robots)]
            errors, covered, doubted = map(np.array, zip(*found, strict=True))
            for kind, which in kinds.items():
                percent, inside = errors[:, which], covered[:, which]
                rows.append(
                    {
                        "machine": name,
                        "engine": engine,
                        "parameter": kind,
                        "bias_percent": float(percent.mean()),
                        "rms_percent": float(np.sqrt((percent**2).mean())),
                        "covered": int(np.nansum(inside)),
                        "intervals": int(np.isfinite(inside).sum()),
                        "doubted": int(doubted.sum()),
                    }
                )
    return {"rows": rows}
