"""Twenty real Droplets next to simulated ones: fitted to how they drive, compared in how they turn.

`droplets.csv` has what each robot was calibrated to drive and turn in 30 s (motion-tuning log of
the repository correlllab/cu-droplet). Unbalance and spin-up of their motors are not published. For
each spin-up, friction and timing of the pulses, the unbalance that gives a robot's driving speed is
found; how fast the simulated robot then turns is a prediction.
"""

import itertools
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from cosim.base.plotting import BLUE, VERMILION, styled
from cosim.calibration.trial import Trial, mean_motion
from cosim.fmi.motor import MotorFmu
from cosim.model.config import CoSimConfig

MEASURED = Path(__file__).with_name("droplets.csv")
MEASURED_S = 30.0
FITTED = slice(0, None, 2)  # every second robot; the others are predicted
HARDLY_MOVES = 17  # index of a robot whose ratio says nothing of the others
UNBALANCES_KG_M = np.geomspace(0.3e-6, 2.1e-6, 14)
# Signs of the motors' voltages: of two opposite ways to drive, and of both turns.
WAYS = ((0, -1, 1), (0, 1, -1), (1, 1, 1), (-1, -1, -1))
DRIVEN_S = 3.0


class Variant(NamedTuple):
    """An assumption about what is not known of Droplets."""

    mu: float
    pulse_s: float
    pause_s: float
    spin_up_s: float  # time constant of the motors

    @property
    def names(self) -> dict[str, Any]:
        """Its values as columns of a row."""
        pulses = f"{1e3 * self.pulse_s:.0f}/{1e3 * self.pause_s:.0f} ms"
        return {"mu": self.mu, "pulses": pulses, "spin_up_ms": 1e3 * self.spin_up_s}


SHOWN = Variant(0.3, 0.03, 0.01, 0.03)  # robot by robot: one that reaches the speeds of all
VARIANTS = tuple(
    Variant(mu, *pulses, spin_up_s)
    for pulses, mu, spin_up_s in itertools.product(
        ((0.03, 0.01), (0.03, 0.04), (0.02, 0.04)), (0.5, 0.4, 0.3), (0.02, 0.03, 0.04, 0.06, 0.08)
    )
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


def measured() -> Motion:
    """Motions of the real robots."""
    table = np.loadtxt(MEASURED, delimiter=",", skiprows=1) / MEASURED_S
    turn = np.radians(table[:, 3:].mean(axis=1))
    return Motion(1e-3 * table[:, 1], 1e-3 * table[:, 2], turn)


def simulated(config: CoSimConfig, fmu: MotorFmu, variant: Variant) -> Motion:
    """Motions of a Droplet over UNBALANCES_KG_M."""
    config = config.having("varied", **variant._asdict() | {"spin_up_s": None})
    motor = config.motor
    inertia = variant.spin_up_s * motor.K_T**2 / motor.R
    motors = [motor._replace(r=u / motor.m, J=inertia) for u in UNBALANCES_KG_M for _ in WAYS]
    robots, period_s = len(motors), config.timing.control_period_s
    cycle_s = 3.0 * (variant.pulse_s + variant.pause_s)
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


def variant_row(variant: Variant, found: Motion) -> dict[str, Any]:
    """What a variant predicts, fitted to how half of the robots drive."""
    real, drive = measured(), np.maximum.accumulate(found.drive_m_s)
    own = _unbalances(drive, real.drive_m_s)
    mine = np.arange(len(own)) != HARDLY_MOVES
    fitted = own[FITTED][np.isfinite(own[FITTED])]
    usual = float(np.median(fitted)) if len(fitted) else math.nan
    row = {**variant.names, "unbalance_g_mm": 1e6 * usual if len(fitted) else None}
    turn = np.interp(own, UNBALANCES_KG_M, found.turn_rad_s)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = 1e3 * real.drive_m_s / turn
        back = np.interp(usual, UNBALANCES_KG_M, found.forward_m_s / found.backward_m_s)
    sizes = {"robots": int(np.isfinite(ratio[mine]).sum())}
    if not np.isfinite(usual) or sizes["robots"] < len(own) // 2:
        return row | sizes | dict.fromkeys(_PREDICTED)
    # What a spread of the unbalance among the fitted robots makes of the others' driving.
    spread = float(np.std(np.log(fitted), ddof=1))
    low, high = np.interp(
        usual * np.exp(spread * np.array([-1.96, 1.96])), UNBALANCES_KG_M, found.drive_m_s
    )
    others = real.drive_m_s[1::2]
    fits = np.isfinite(ratio) & mine
    values = (
        float(np.median(ratio[fits])),
        float(ratio[fits].min()),
        float(ratio[fits].max()),
        float(back),
        spread,
        int(((others >= low) & (others <= high)).sum()),
        float(np.sqrt(np.mean(np.log(turn[fits] / real.turn_rad_s[fits]) ** 2))),
    )
    return row | sizes | dict(zip(_PREDICTED, values, strict=True))


_PREDICTED = (
    "drive_over_turn_mm_rad",
    "least_mm_rad",
    "largest_mm_rad",
    "forward_over_backward",
    "unbalance_spread",  # standard deviation of its logarithm among the fitted robots
    "others_within",  # of the robots that were not fitted: in the 95 % that this spread predicts
    "turn_error",  # root mean square of the logarithm of simulated over measured turning
)


def _unbalances(drive_m_s: np.ndarray, wanted_m_s: np.ndarray) -> np.ndarray:
    """Unbalances at which a variant drives at some speeds; NaN beyond its range."""
    return np.interp(wanted_m_s, drive_m_s, UNBALANCES_KG_M, left=np.nan, right=np.nan)


def measured_row() -> dict[str, Any]:
    """The real robots' values of the same columns."""
    real = measured()
    mine = np.arange(len(real.turn_rad_s)) != HARDLY_MOVES
    ratio = (1e3 * real.drive_m_s / real.turn_rad_s)[mine]
    back = float(np.median(real.forward_m_s / real.backward_m_s))
    values = float(np.median(ratio)), float(ratio.min()), float(ratio.max()), back, None, None, None
    unknown = dict.fromkeys(("mu", "spin_up_ms", "unbalance_g_mm"))
    return (
        unknown
        | {"pulses": "measured", "robots": len(ratio)}
        | dict(zip(_PREDICTED, values, strict=True))
    )


def robot_rows(found: Motion) -> Iterator[dict[str, Any]]:
    """Each real robot, and how fast one turns that drives as fast in the simulation."""
    real = measured()
    own = _unbalances(np.maximum.accumulate(found.drive_m_s), real.drive_m_s)
    turn = np.interp(own, UNBALANCES_KG_M, found.turn_rad_s)
    units = 1e3, math.degrees(1.0), math.degrees(1.0), 1e6
    names = "drive_mm_s", "turn_deg_s", "simulated_deg_s", "unbalance_g_mm"
    table = np.column_stack([real.drive_m_s, real.turn_rad_s, turn, own]) * units
    for number, values in enumerate(table.tolist(), 1):
        known = (None if math.isnan(value) else value for value in values)
        yield {"robot": number, **dict(zip(names, known, strict=True))}


@styled
def draw(robots: list[dict[str, Any]]) -> Figure:
    """Turning over driving, of real robots and of simulated ones that drive as fast."""
    figure = Figure(figsize=(6.4, 4.6), layout="constrained")
    axes = figure.subplots()
    drive = np.array([row["drive_mm_s"] for row in robots])
    real, found = (
        np.array([np.nan if row[name] is None else row[name] for row in robots])
        for name in ("turn_deg_s", "simulated_deg_s")
    )
    for x, y, z in zip(drive, real, found, strict=True):
        axes.plot([x, x], [y, z], color="0.8", zorder=1)
    axes.plot(drive, real, "o", color=VERMILION, label="measured, one point per Droplet")
    label = f"simulated at its driving speed: μ = {SHOWN.mu:g}, {1e3 * SHOWN.spin_up_s:.0f} ms"
    axes.plot(drive, found, "x", color=BLUE, label=label)
    axes.set(xlabel="driving, mm/s", ylabel="turning, °/s", xlim=(0.0, None), ylim=(0.0, None))
    axes.legend()
    return figure
