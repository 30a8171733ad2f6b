"""Machines that are known, and tracks of them: co-simulated, and seen by a camera."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from cosim.calibration.trial import Trial, heading_angles
from cosim.fmi.motor import MotorFmu
from cosim.machine.identification.simulated import machine
from cosim.machine.identification.track import FRAME_RATE_HZ, HOLD_S, SEQUENCE, SeenTrack
from cosim.model.config import CoSimConfig
from cosim.model.params import TABLE_II, MotorParams
from cosim.model.world import Sensor, World, draw_world
from cosim.onboard.camera import draw_sight
from cosim.onboard.steering import DIRECT, MODE, OMEGA_D, OMEGA_E
from fmus.build import cached_fmu

CAMERA = Sensor(FRAME_RATE_HZ, 50.0, 0.5, 1.0)
MOTOR_SPREAD = 0.1
# Uniform between these, SI units; motors are drawn as in `cosim.model.world`.
RANGES = ((0.1, 0.3), (0.01, 0.02), (-1e-3, 1e-3), (-1e-3, 1e-3), (0.02, 0.024))


class Truth(NamedTuple):
    """A machine that was drawn.

    Attributes:
        values: (8,), see `cosim.machine.identification.simulated`.
        motors: D and E.
    """

    values: np.ndarray
    motors: tuple[MotorParams, ...]


def draw_machine(seed: np.random.SeedSequence) -> Truth:
    """A machine at random."""
    rng = np.random.default_rng(seed)
    (motors,) = draw_world(World(motor_spread=MOTOR_SPREAD), (TABLE_II,) * 2, 1, seed).motors
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
