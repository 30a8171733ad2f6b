"""Motor speeds that make a robot show what it is, and what its motors make of them."""

import csv
from pathlib import Path

import numpy as np

from cosim.base.storage import replacing
from cosim.coupling.assembly import Motors, SpeedNoise
from cosim.coupling.fmu import MotorFmu
from cosim.coupling.signals import MOTORS
from cosim.model.config import CoSimConfig

# Set points of motors D and E in rad/s, each held for HOLD_S. Magnitudes differ by 100 rad/s or
# more, so that the phase between the motors goes around many times a second and averages out; they
# stay where tracks depend smoothly on all parameters, although feet lift (docs/identification.md).
HOLD_S = 3.0
SEQUENCE = (
    (-800.0, 900.0),
    (900.0, -800.0),
    (1000.0, 0.0),
    (0.0, -1000.0),
    (900.0, 750.0),
    (-1000.0, 0.0),
    (0.0, 1000.0),
    (-750.0, -900.0),
    (-900.0, 700.0),
    (700.0, -900.0),
) * 2
FRAME_RATE_HZ = 30.0


def write_excitation(path: Path) -> None:
    """Write the sequence to drive a robot with: `time,omega_1,omega_2`, 30 rows a second."""
    frames = np.arange(round(len(SEQUENCE) * HOLD_S * FRAME_RATE_HZ) + 1)
    with replacing(path) as temporary, temporary.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("time", "omega_1", "omega_2"))
        for time_s in (frames / FRAME_RATE_HZ).round(6).tolist():
            row = int(time_s / HOLD_S)
            writer.writerow((time_s, *(SEQUENCE[row] if row < len(SEQUENCE) else (0.0, 0.0))))


def motor_speeds(
    set_points: np.ndarray, fmu: MotorFmu, config: CoSimConfig, seed: np.random.SeedSequence | None
) -> np.ndarray:
    """Speeds of motors D and E in rad/s at the ends of control periods.

    Args:
        set_points: (P, 2) in rad/s, of every control period.
        fmu: of both motors.
        config: their parameters, noise and clock.
        seed: of the noise; None for none.

    Returns:
        (P + 1, 2), from the start of the motors.

    Raises:
        FmuError: the FMU failed.
    """
    ticks, dt_s = config.ticks_per_period, config.timing.dt_s
    noise = np.zeros((len(set_points), 1, 2))
    if seed is not None:
        noise = SpeedNoise(config, seed, 1).draw(len(set_points))
    speeds = np.zeros((len(set_points) + 1, 2))
    inputs, outputs = np.zeros((3 * MOTORS, 1)), np.zeros((3 * MOTORS, 1))
    motors = Motors(fmu, config, 1)
    speeds[0] = motors.restart([0], ((config.motor, config.motor),))[MOTORS:, 0]
    try:
        for period, wanted in enumerate(set_points):
            inputs[: 2 * MOTORS, 0] = *wanted, *(noise[period, 0] * abs(wanted))
            motors.set_inputs(inputs, dt_s)
            motors.step(ticks, dt_s)
            motors.get_outputs(outputs, dt_s)
            speeds[period + 1] = outputs[MOTORS : 2 * MOTORS, 0]
    finally:
        motors.close()
    return speeds
