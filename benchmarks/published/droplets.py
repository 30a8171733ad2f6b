"""Twenty real Droplets next to simulated ones: fitted to how they drive, compared in how they turn.

`droplet_trials.csv` has every trial of their motion tuning: drives of 30 s in four directions.
Unbalance and spin-up of their motors are not published. For each spin-up and friction, the
unbalance that gives a robot's driving speed is found; how fast the simulated robot then turns is a
prediction.
"""

import itertools
import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from cosim.base.colours import BLUE, VERMILION
from cosim.base.plotting import styled
from cosim.calibration.trial import Trial, mean_motion
from cosim.fmi.motor import MotorFmu
from cosim.model.config import CoSimConfig

TRIALS = Path(__file__).with_name("droplet_trials.csv")
TRIAL_S = 30.0
# Directions of trials, two opposite ways to drive and both turns, with the sign of the angle that
# the camera saw.
DIRECTIONS = {0: 1.0, 3: 1.0, 6: -1.0, 7: 1.0}
PULSE_S, PAUSE_S = 0.02, 0.04  # of the firmware at the time of the trials
# Driving is the length of a path in units of the picture: about a millimetre each by photos of the
# arena (assumed); a radius of 36 units in the code would make one 0.61.
UNIT_MM, SMALL_UNIT_MM = 1.0, 0.61
BATCHES = 5  # of the trials of a robot in one direction
HARDLY_MOVES = 17  # index of a robot whose ratio says nothing of the others
UNBALANCES_KG_M = np.geomspace(0.3e-6, 4.2e-6, 18)
# Signs of the motors' voltages: of two opposite ways to drive, and of both turns.
WAYS = ((0, -1, 1), (0, 1, -1), (1, 1, 1), (-1, -1, -1))
DRIVEN_S = 3.0


class Variant(NamedTuple):
    """An assumption about what is not known of Droplets."""

    mu: float
    spin_up_s: float  # time constant of the motors
    unit_mm: float = UNIT_MM  # length of a unit of the trials


SHOWN = Variant(0.3, 0.03)  # robot by robot
VARIANTS = (
    *itertools.starmap(Variant, itertools.product((0.5, 0.4, 0.3), (0.02, 0.03, 0.04, 0.06))),
    *(Variant(0.3, spin_up_s, SMALL_UNIT_MM) for spin_up_s in (0.02, 0.03, 0.04)),
)


class Motion(NamedTuple):
    """Speeds over a parameter or of robots."""

    forward_m_s: np.ndarray
    backward_m_s: np.ndarray
    turn_rad_s: np.ndarray  # mean of both ways

    @property
    def drive_m_s(self) -> np.ndarray:
        """Mean of both ways."""
        return 0.5 * (self.forward_m_s + self.backward_m_s)


class Measured(NamedTuple):
    """Motions of the real robots, and relative standard errors of driving and turning."""

    motion: Motion
    drive_error: np.ndarray
    turn_error: np.ndarray


def batch_medians(trials: np.ndarray) -> tuple[float, float]:
    """Return the median of consecutive trials and its standard error, from medians of batches.

    Trials of a robot drift and are correlated: their scatter over the root of their number would be
    too small. Long batches are nearly independent, and a drift is scatter between them. Some trials
    have the sign of the other turn, which a median leaves out.
    """
    medians = [np.median(batch) for batch in np.array_split(trials, BATCHES)]
    return float(np.median(trials)), float(np.std(medians, ddof=1) / math.sqrt(BATCHES))


def measured(unit_mm: float = UNIT_MM) -> Measured:
    """Motions of the real robots, in the order of their numbers."""
    robot, direction, value = np.loadtxt(TRIALS, delimiter=",", skiprows=1, usecols=(0, 2, 4)).T
    found = np.array(
        [
            [batch_medians(sign * value[(robot == r) & (direction == d)]) for r in np.unique(robot)]
            for d, sign in DIRECTIONS.items()
        ]
    )
    (middle, error), metres = np.moveaxis(found, -1, 0) / TRIAL_S, 1e-3 * unit_mm
    motion = Motion(metres * middle[0], metres * middle[1], np.radians(middle[2:].mean(axis=0)))
    relative = [np.hypot(*error[k]) / middle[k].sum(axis=0) for k in (slice(0, 2), slice(2, 4))]
    return Measured(motion, *relative)


def simulated(config: CoSimConfig, fmu: MotorFmu, mu: float, spin_up_s: float) -> Motion:
    """Motions of a Droplet over UNBALANCES_KG_M."""
    config = config.having("varied", mu=mu, pulse_s=PULSE_S, pause_s=PAUSE_S)
    motor = config.motor
    inertia = spin_up_s * motor.K_T**2 / motor.R
    motors = [motor._replace(r=u / motor.m, J=inertia) for u in UNBALANCES_KG_M for _ in WAYS]
    robots, period_s = len(motors), config.timing.control_period_s
    cycle_s = 3.0 * (PULSE_S + PAUSE_S)
    with Trial(
        fmu, config, np.zeros(robots), np.random.SeedSequence(0), [(own,) * 3 for own in motors]
    ) as trial:
        trial.set_motors(config.top_speed_rad_s * np.tile(WAYS, (len(UNBALANCES_KG_M), 1)))
        trial.advance(round(4.0 * cycle_s / period_s))
        before = trial.poses
        samples = trial.advance(round(math.ceil(DRIVEN_S / cycle_s) * cycle_s / period_s))
    motion = mean_motion(before, [samples], period_s).reshape(-1, len(WAYS), 3)
    forward, backward = np.hypot(motion[:, :2, 0], motion[:, :2, 1]).T
    return Motion(forward, backward, np.abs(motion[:, 2:, 2]).mean(axis=1))


class _Fit(NamedTuple):
    """Simulated robots that drive as fast as real ones; NaN where no unbalance does."""

    unbalance_kg_m: np.ndarray
    turn_rad_s: np.ndarray
    data_error: np.ndarray  # standard error of ln(simulated over measured turning), by the trials


def _fitted(found: Motion, real: Measured) -> _Fit:
    drive = np.maximum.accumulate(found.drive_m_s)

    def turns(drive_m_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        own = np.interp(drive_m_s, drive, UNBALANCES_KG_M, left=np.nan, right=np.nan)
        return own, np.interp(own, UNBALANCES_KG_M, found.turn_rad_s)

    wanted = real.motion.drive_m_s
    own, turn = turns(wanted)
    with np.errstate(invalid="ignore"):
        high, low = (turns(wanted * np.exp(s * real.drive_error))[1] for s in (0.5, -0.5))
        by_driving = np.nan_to_num(np.log(high / low))  # turning for a change of driving
    return _Fit(own, turn, np.hypot(by_driving, real.turn_error))


def variant_row(variant: Variant, found: Motion) -> dict[str, Any]:
    """What a variant predicts, fitted to how the robots drive."""
    real = measured(variant.unit_mm)
    fit = _fitted(found, real)
    ratio = 1e3 * real.motion.drive_m_s / fit.turn_rad_s
    good = np.isfinite(ratio) & (np.arange(len(ratio)) != HARDLY_MOVES)
    row = {
        "mu": variant.mu,
        "spin_up_ms": 1e3 * variant.spin_up_s,
        "unit_mm": variant.unit_mm,
        "robots": int(good.sum()),
    }
    if row["robots"] < len(ratio) // 2:
        return row | dict.fromkeys(_PREDICTED)
    usual = float(np.median(fit.unbalance_kg_m[good]))
    error = np.log(fit.turn_rad_s[good] / real.motion.turn_rad_s[good])
    values = (
        1e6 * usual,
        *_spread(ratio[good]),
        float(np.interp(usual, UNBALANCES_KG_M, found.forward_m_s / found.backward_m_s)),
        float(np.exp(error.mean())),
        _rms(error),
        _rms(fit.data_error[good]),
    )
    return row | dict(zip(_PREDICTED, values, strict=True))


_PREDICTED = (
    "unbalance_g_mm",  # median
    "drive_over_turn_mm_rad",
    "least_mm_rad",
    "largest_mm_rad",
    "forward_over_backward",
    "turn_ratio",  # simulated over measured turning, geometric mean
    "turn_error",  # root mean square of its logarithm
    "data_error",  # what the trials' own errors would make of that
)


def _spread(values: np.ndarray) -> tuple[float, float, float]:
    return float(np.median(values)), float(values.min()), float(values.max())


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def measured_row(unit_mm: float) -> dict[str, Any]:
    """The real robots' values of the same columns."""
    real = measured(unit_mm)
    good = np.arange(len(real.drive_error)) != HARDLY_MOVES
    motion = real.motion
    ratio = (1e3 * motion.drive_m_s / motion.turn_rad_s)[good]
    back = float(np.median(motion.forward_m_s / motion.backward_m_s))
    unknown = dict.fromkeys(("mu", "spin_up_ms", "unbalance_g_mm", "turn_ratio", "turn_error"))
    known = dict(zip(_PREDICTED[1:5], (*_spread(ratio), back), strict=True))
    return unknown | {"unit_mm": unit_mm, "robots": len(ratio), "data_error": None} | known


def robot_rows(found: Motion) -> list[dict[str, Any]]:
    """Each real robot, and how fast one turns that drives as fast in the simulation.

    Intervals are of 95 %, by Student's t of `batch_medians`.
    """
    real = measured(SHOWN.unit_mm)
    fit, motion = _fitted(found, real), real.motion
    rows = []
    for k in range(len(motion.turn_rad_s)):
        values = {
            "drive_mm_s": 1e3 * motion.drive_m_s[k],
            "drive_error": STUDENT * real.drive_error[k],
            "turn_deg_s": math.degrees(motion.turn_rad_s[k]),
            "turn_error": STUDENT * real.turn_error[k],
            "simulated_deg_s": math.degrees(fit.turn_rad_s[k]),
            "unbalance_g_mm": 1e6 * fit.unbalance_kg_m[k],
        }
        known = {name: None if math.isnan(v) else float(v) for name, v in values.items()}
        rows.append({"robot": k + 1} | known)
    return rows


STUDENT = 2.776  # quantile 0.975 of Student's t of BATCHES - 1 degrees of freedom


@styled
def draw(robots: list[dict[str, Any]]) -> Figure:
    """Turning over driving, of real robots and of simulated ones that drive as fast."""
    figure = Figure(figsize=(6.4, 4.6), layout="constrained")
    axes = figure.subplots()
    drive, real, found, across, up = (
        np.array([np.nan if row[name] is None else row[name] for row in robots])
        for name in ("drive_mm_s", "turn_deg_s", "simulated_deg_s", "drive_error", "turn_error")
    )
    for x, y, z in zip(drive, real, found, strict=True):
        axes.plot([x, x], [y, z], color="0.8", zorder=1)
    label = "measured, one point per Droplet, 95 %"
    bars = {"xerr": drive * across, "yerr": np.abs(real * up), "elinewidth": 0.6}
    axes.errorbar(drive, real, **bars, fmt="o", ms=4, color=VERMILION, label=label)
    label = f"simulated at its driving speed: μ = {SHOWN.mu:g}, {1e3 * SHOWN.spin_up_s:.0f} ms"
    axes.plot(drive, found, "x", color=BLUE, label=label)
    axes.set(xlabel="driving, mm/s", ylabel="turning, °/s", xlim=(0.0, None), ylim=(0.0, None))
    axes.legend(loc="upper left")  # where no robot is
    return figure
