"""The map between motor speeds and the robot's motion: trials, curves, inverse, refusal.

A record that can be kept in a file and asked; `cosim.calibration.measuring` makes it.
"""

from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np

from cosim.base.errors import UserError
from cosim.base.reading import Kind, read_arrays
from cosim.base.storage import write_arrays
from cosim.model.config import CoSimConfig

# Signs of (ω_D, ω_E), Eq. (3).
MANOEUVRES = {
    "forwards": (-1.0, 1.0),
    "backwards": (1.0, -1.0),
    "left": (1.0, 1.0),
    "right": (-1.0, -1.0),
}
DRIVES = ("forwards", "backwards")
# Share of time without any foot on the floor from which robots with bouncing feet hop. Below it the
# speeds are those of feet that do not bounce, within some per cent; above it they depend on the
# phase between the motors (docs/physics.md).
BOUNCING_SHARE = 0.12
LEAST_M_S = 5e-5  # assumed: below, a cell takes minutes, and robots count as not moving
_WEAK = 0.9  # of the largest set point: below, motors do not follow it


@dataclass(frozen=True)
class Curve:
    """One manoeuvre over motor speed, at equal speeds of both motors."""

    omega_rad_s: np.ndarray  # (K,) mean motor speed, ascending
    # (K,) speed in m/s along the heading (backwards positive too) or yaw rate in rad/s towards the
    # manoeuvre's side
    mean: np.ndarray
    scatter: np.ndarray  # (K,) standard deviation over phases and seeds
    airborne_share: np.ndarray  # (K,) largest share of time in which no foot touched the floor
    lifted_share: np.ndarray  # (K,) mean share of time in which a foot did not


@dataclass(frozen=True)
class Calibration:
    """Trials of one robot, T of them; the first axis of every array."""

    set_points_rad_s: np.ndarray  # (T, 2) commanded speeds of motors D and E, without dither
    omega_rad_s: np.ndarray  # (T, 2) mean speeds that the motors had
    phase_rad: np.ndarray  # (T,) initial phase difference between the motors
    dithered: np.ndarray  # (T,) bool, whether the dither of the steering was on
    forward_m_s: np.ndarray  # (T,) mean speed along the heading
    lateral_m_s: np.ndarray  # (T,) mean speed to the left of it
    yaw_rate_rad_s: np.ndarray  # (T,) mean, counter-clockwise positive
    airborne_share: np.ndarray  # (T,) share of time in which no foot touched the floor
    lifted_share: np.ndarray  # (T,) share of time in which a foot did not
    restitution: np.ndarray  # () of the feet

    def curve(self, manoeuvre: str, *, dithered: bool = True) -> Curve:
        """Speed or yaw rate over motor speed of one of `MANOEUVRES`."""
        signs = MANOEUVRES[manoeuvre]
        set_speed = self.set_points_rad_s[:, 1] * signs[1]
        chosen = (self.dithered == dithered) & (self.set_points_rad_s[:, 0] * signs[0] == set_speed)
        chosen &= set_speed > 0.0
        motion = self.forward_m_s if manoeuvre in DRIVES else self.yaw_rate_rad_s
        rows = []
        for speed in np.unique(set_speed[chosen]):
            here = chosen & (set_speed == speed)
            value = motion[here] * signs[1]
            omega = np.abs(self.omega_rad_s[here]).mean()
            shares = self.airborne_share[here].max(), self.lifted_share[here].mean()
            rows.append((omega, value.mean(), value.std(), *shares))
        return Curve(*np.array(sorted(rows)).reshape(-1, 5).T)

    @property
    def hop_free_rad_s(self) -> float:
        """Largest motor speed of a manoeuvre without hops.

        Robots hop where no foot is on the floor, ever; for more than BOUNCING_SHARE of the time
        where feet bounce.
        """
        share = BOUNCING_SHARE if self.restitution > 0.0 else 0.0
        return min(_hop_free(self.curve(manoeuvre), share) for manoeuvre in MANOEUVRES)

    def largest(self, manoeuvre: str) -> float:
        """Largest speed in m/s or yaw rate in rad/s without hopping, at whichever motor speed."""
        curve, limit = self.curve(manoeuvre), self.hop_free_rad_s
        below = curve.mean[curve.omega_rad_s < limit]
        return float(below.max(initial=np.interp(limit, curve.omega_rad_s, curve.mean)))

    def require_motion(self, mu: float) -> None:
        """Refuse robots that do not move."""
        if min(self.largest(drive) for drive in DRIVES) >= LEAST_M_S:
            return
        reached, asked = (np.abs(v).max() for v in (self.omega_rad_s, self.set_points_rad_s))
        if reached < _WEAK * asked:
            raise UserError(
                f"the motors are too weak to move the robot: they reach {reached:.0f} of "
                f"{asked:.0f} rad/s; give stronger ones by --motor-fmu or --motor-parameter"
            )
        raise UserError(
            f"with mu = {mu:g} robots drive less than {1e3 * LEAST_M_S:g} mm/s at any motor "
            "speed; change the preset, friction or motor parameters"
        )

    def motor_speed(self, manoeuvre: str, value: float) -> float:
        """Speed in rad/s of both motors for a speed in m/s or a yaw rate in rad/s.

        Of several motor speeds that realise it, the slowest.
        """
        curve = self.curve(manoeuvre)
        largest = self.largest(manoeuvre)
        factor, unit = (1e3, "mm/s") if manoeuvre in DRIVES else (180.0 / np.pi, "°/s")
        if value > largest:
            raise UserError(
                f"{factor * value:.3g} {unit} {manoeuvre} would make the robot hop; the largest "
                f"possible is {np.floor(100.0 * factor * largest) / 100.0:.2f} {unit}"
            )
        if value < curve.mean[0]:
            raise UserError(
                f"{factor * value:.3g} {unit} {manoeuvre} is less than the map of speeds has; the "
                f"least is {np.ceil(100.0 * factor * curve.mean[0]) / 100.0:.2f} {unit}"
            )
        end = int((curve.mean >= value).argmax()) + 1  # the first trial that is fast enough
        return float(np.interp(value, curve.mean[:end][-2:], curve.omega_rad_s[:end][-2:]))

    def resolved(self, config: CoSimConfig, *, slower: bool = False) -> CoSimConfig:
        """The configuration with the motor speeds that realise its drive speed and turn rate.

        A turn rate beyond the largest becomes the largest: turning more slowly only takes longer.
        A drive speed beyond the largest does if `slower`, and is refused otherwise.
        """
        self.require_motion(config.robot.mu)
        speed_m_s, rate = config.steering.drive_speed_m_s, config.steering.turn_rate_rad_s
        largest = min(self.largest(drive) for drive in DRIVES)
        if speed_m_s > largest and not slower:
            raise UserError(
                f"a drive speed of {1e3 * speed_m_s:.3g} mm/s would make the robot "
                f"hop; the largest possible is {np.floor(1e5 * largest) / 100.0:.2f} mm/s"
            )
        forward, backward = (self.motor_speed(d, min(speed_m_s, largest)) for d in DRIVES)
        sides = ("left", "right")
        largest_rate = min(self.largest(side) for side in sides)
        if largest_rate < max(self.curve(side).mean[0] for side in sides):
            raise UserError(
                f"robots of diameter_m = {config.robot.diameter_m:g} hop at every motor speed that "
                "turns them; make them larger, or change the preset, friction or motor parameters"
            )
        turn = max(self.motor_speed(side, min(rate, largest_rate)) for side in sides)
        for kind, name, limit in (
            ("speed", "drive_speed_m_s", largest),
            ("turn rate", "turn_rate_rad_s", largest_rate),
        ):
            if getattr(config.steering, name) > limit:
                source = f"computed: the largest {kind} without hopping"
                config = config.having(source, **{name: limit})
        return config.having(
            "calibrated",
            forward_speed_rad_s=round(forward, 1),
            backward_speed_rad_s=round(backward, 1),
            turn_speed_rad_s=round(turn, 1),
            max_speed_rad_s=round(self.hop_free_rad_s, 1),
        )

    def save(self, path: Path) -> None:
        """Write the trials (npz); the file appears whole or not at all."""
        write_arrays(path, asdict(self))


def _hop_free(curve: Curve, share: float) -> float:
    hops = curve.omega_rad_s[curve.airborne_share > share].min(initial=np.inf)
    if hops == curve.omega_rad_s[0]:
        raise UserError(
            f"the robot hops at every motor speed from {hops:.0f} rad/s; choose less restitution "
            "for the world, or a heavier robot"
        )
    return float(curve.omega_rad_s[curve.omega_rad_s < hops].max())


def load_calibration(path: Path) -> Calibration:
    """Trials of a file."""
    kind = Kind("calibration", "make it with `minirobots calibrate`")
    return Calibration(**read_arrays(path, kind, [field.name for field in fields(Calibration)]))
