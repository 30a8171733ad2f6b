"""Measure how much of the body's reaction on the motors the paper neglects.

Drives one robot straight with and without `reaction` (the torque that the body's acceleration
exerts on each eccentric mass) and compares torques, motor speeds and drive speeds. No noise, so
that the difference is the reaction's alone.
"""

import numpy as np

from cosim.model.config import CoSimConfig
from cosim.model.params import SPEED_NOISE, TABLE_II
from cosim.model.scenario import Scenario
from cosim.simulation.cosimulation import CoSimulation
from fmus.build import cached_fmu
from minirobots.options import CommandOptions, Count

NORTH = 2
SETTLED = 500  # control periods after which the motors run steadily


class Options(CommandOptions):
    steps: Count = 5
    """RL steps of 2 s to drive."""


def drive(reaction: bool, steps: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Motor speeds (n, 2) in rad/s, reaction torques (n, 2) in N m, and path length in m."""
    scenario = Scenario("lane", "", ((15, 29),), (((15, 10),),))
    config = CoSimConfig(noise=SPEED_NOISE._replace(relative_amplitude=0.0), reaction=reaction)
    system = CoSimulation(scenario, cached_fmu(), config)
    system.reset(((15, 10),), np.random.SeedSequence(0))
    omega, torque = [], []
    for _ in range(steps):
        step = system.advance(np.array([NORTH]))
        driving = step.samples.omega_des[:, 0, 0] != 0.0
        omega.append(step.samples.omega[driving, 0][SETTLED:])
        torque.append(step.samples.disturbance[driving, 0][SETTLED:])
    length_m = float(system.measures.path_length_m[0])
    system.close()
    return np.abs(np.concatenate(omega)), np.concatenate(torque), length_m


def measure(options: Options) -> dict[str, float]:
    omega_without, _, without_m = drive(False, options.steps)
    omega_with, torque, with_m = drive(True, options.steps)
    return {
        "torque_rms_over_coulomb": float(np.sqrt((torque**2).mean()) / TABLE_II.c),
        "torque_max_over_coulomb": float(np.abs(torque).max() / TABLE_II.c),
        "motor_speed_change_rad_s": float(omega_with.mean() - omega_without.mean()),
        "ripple_without_rad_s": float(omega_without.std()),
        "ripple_with_rad_s": float(omega_with.std()),
        "drive_speed_change": with_m / without_m - 1.0,
    }
