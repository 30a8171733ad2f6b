"""The map between motor speeds and a machine's motion: trials, curves, inverse, refusal.

A record that can be kept in a file and asked; `cosim.calibration.measuring` makes it.
"""

from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np

from cosim.base.errors import UserError
from cosim.base.reading import Kind, read_arrays
from cosim.base.storage import write_arrays
from cosim.model.config import CoSimConfig

# Directions (ahead, left, counter-clockwise) of motion primitives, by the fields of `MotorShares`.
DIRECTIONS = {
    "forwards": (1.0, 0.0, 0.0),
    "backwards": (-1.0, 0.0, 0.0),
    "leftwards": (0.0, 1.0, 0.0),
    "rightwards": (0.0, -1.0, 0.0),
    "left_turn": (0.0, 0.0, 1.0),
    "right_turn": (0.0, 0.0, -1.0),
}
DRIVES, TURNS = tuple(DIRECTIONS)[:4], tuple(DIRECTIONS)[4:]
# Share of time without any foot on the floor from which robots with bouncing feet hop. Below it the
# speeds are those of feet that do not bounce, within some per cent; above it they depend on the
# phase between the motors (docs/physics.md).
BOUNCING_SHARE = 0.12
MAY_HOP_SHARE = 0.99  # of robots with pulsed motors or elastic legs, which may not fall
LEAST_M_S = 5e-5  # assumed: below, a cell takes minutes, and robots count as not moving
_WEAK = 0.9  # of the largest set point: below, motors do not follow it


@dataclass(frozen=True)
class Curve:
    """One primitive over motor speed."""

    omega_rad_s: np.ndarray  # (K,) mean motor speed, ascending
    mean: np.ndarray  # (K,) speed in m/s or yaw rate in rad/s in the primitive's direction
    scatter: np.ndarray  # (K,) standard deviation over phases and seeds
    airborne_share: np.ndarray  # (K,) largest share of time in which no foot touched the floor
    lifted_share: np.ndarray  # (K,) mean share of time in which a foot did not


@dataclass(frozen=True)
class Calibration:
    """Trials of one robot, T of them; the first axis of every array."""

    primitive: np.ndarray  # (T,) place in DIRECTIONS
    set_speed_rad_s: np.ndarray  # (T,) commanded: motors get their shares of it
    difference_rad_s: np.ndarray  # (T,) commanded in addition, in the drive's own difference
    phase_rad: np.ndarray  # (T,) initial phase difference from motor to motor
    dithered: np.ndarray  # (T,) bool, whether the dither of the steering was on
    # (T, M) mean speeds of the motors with the largest share, over that, NaN of the others; what
    # was commanded where the steering has no dither
    omega_rad_s: np.ndarray
    forward_m_s: np.ndarray  # (T,) mean speed along the heading
    lateral_m_s: np.ndarray  # (T,) mean speed to the left of it
    yaw_rate_rad_s: np.ndarray  # (T,) mean, counter-clockwise positive
    airborne_share: np.ndarray  # (T,) share of time in which no foot touched the floor
    lifted_share: np.ndarray  # (T,) share of time in which a foot did not
    hopping_share: np.ndarray  # () of that time, beyond which the robot hops

    @property
    def primitives(self) -> list[str]:
        """Names of what the machine can do."""
        return [name for k, name in enumerate(DIRECTIONS) if (self.primitive == k).any()]

    def curve(self, name: str, *, dithered: bool = True) -> Curve:
        """Speed or yaw rate over motor speed of one of `primitives`."""
        chosen = (self.primitive == list(DIRECTIONS).index(name)) & (self.dithered == dithered)
        chosen &= self.difference_rad_s == 0.0
        motion = np.column_stack([self.forward_m_s, self.lateral_m_s, self.yaw_rate_rad_s])
        along, rows = motion @ DIRECTIONS[name], []
        for speed in np.unique(self.set_speed_rad_s[chosen]):
            here = chosen & (self.set_speed_rad_s == speed)
            shares = self.airborne_share[here].max(), self.lifted_share[here].mean()
            omega, value = np.nanmean(np.abs(self.omega_rad_s[here])), along[here]
            rows.append((omega, value.mean(), value.std(), *shares))
        return Curve(*np.array(sorted(rows)).reshape(-1, 5).T)

    @property
    def hop_free_rad_s(self) -> float:
        """Largest motor speed of all primitives without hops."""
        share = float(self.hopping_share)
        return min(_hop_free(self.curve(name), share) for name in self.primitives)

    def largest(self, name: str) -> float:
        """Largest speed in m/s or yaw rate in rad/s without hopping, at whichever motor speed."""
        curve, limit = self.curve(name), self.hop_free_rad_s
        below = curve.mean[curve.omega_rad_s < limit]
        return float(below.max(initial=np.interp(limit, curve.omega_rad_s, curve.mean)))

    def largest_of(self, names: tuple[str, ...]) -> float:
        """Largest speed or yaw rate that the machine has in all of some primitives that it can."""
        return min((self.largest(name) for name in names if name in self.primitives), default=0.0)

    def motor_speed(self, name: str, value: float) -> float:
        """Motor speed in rad/s for a speed in m/s or a yaw rate in rad/s.

        Of several motor speeds that realise it, the slowest.
        """
        curve = self.curve(name)
        largest = self.largest(name)
        factor, unit = (1e3, "mm/s") if name in DRIVES else (180.0 / np.pi, "°/s")
        if value > largest:
            raise UserError(
                f"{factor * value:.3g} {unit} {name} would make the robot hop; the largest "
                f"possible is {np.floor(100.0 * factor * largest) / 100.0:.2f} {unit}"
            )
        if value < curve.mean[0]:
            raise UserError(
                f"{factor * value:.3g} {unit} {name} is less than the map of speeds has; the "
                f"least is {np.ceil(100.0 * factor * curve.mean[0]) / 100.0:.2f} {unit}"
            )
        end = int((curve.mean >= value).argmax()) + 1  # the first trial that is fast enough
        return float(np.interp(value, curve.mean[:end][-2:], curve.omega_rad_s[:end][-2:]))

    def require_motion(self, mu: float) -> None:
        """Refuse robots that do not drive."""
        if self.largest_of(DRIVES) >= LEAST_M_S:
            return
        reached, asked = np.nanmax(np.abs(self.omega_rad_s)), self.set_speed_rad_s.max()
        if reached < _WEAK * asked:
            raise UserError(
                f"the motors are too weak to move the robot: they reach {reached:.0f} of "
                f"{asked:.0f} rad/s; give stronger ones by --motor-fmu or --motor-parameter"
            )
        raise UserError(
            f"with mu = {mu:g} robots drive less than {1e3 * LEAST_M_S:g} mm/s at any motor "
            "speed; change the preset, friction or motor parameters"
        )

    def resolved(self, config: CoSimConfig, *, slower: bool = False) -> CoSimConfig:
        """The configuration with the motor speeds that realise its drive speed and turn rate.

        Sideways, robots drive as fast as they can up to that. A turn rate beyond the largest
        becomes the largest: turning more slowly only takes longer. A drive speed beyond the largest
        does if `slower`, and is refused otherwise.
        """
        self.require_motion(config.robot.mu)
        steering = config.steering
        speed_m_s, rate = steering.drive_speed_m_s, steering.turn_rate_rad_s
        largest, largest_rate = self.largest_of(DRIVES[:2]), self.largest_of(TURNS)
        if speed_m_s > largest and not slower:
            raise UserError(
                f"a drive speed of {1e3 * speed_m_s:.3g} mm/s would make the robot "
                f"hop; the largest possible is {np.floor(1e5 * largest) / 100.0:.2f} mm/s"
            )
        speed_m_s, rate = min(speed_m_s, largest), min(rate, largest_rate)
        turns = [name for name in TURNS if name in self.primitives]
        if any(rate < self.curve(name).mean[0] for name in turns):
            raise UserError(
                f"robots of diameter_m = {config.robot.diameter_m:g} hop at every motor speed that "
                "turns them; make them larger, or change the preset, friction or motor parameters"
            )
        speeds = {
            name: self.motor_speed(
                name, min(rate if name in turns else speed_m_s, self.largest(name))
            )
            for name in self.primitives
        }
        for kind, name, limit in (
            ("speed", "drive_speed_m_s", largest),
            ("turn rate", "turn_rate_rad_s", largest_rate),
        ):
            if getattr(steering, name) > limit:
                source = f"computed: the largest {kind} without hopping"
                config = config.having(source, **{name: limit})
        # Both sides share a speed, and so do both turns.
        of = [
            max((round(speeds[name], 1) for name in names if name in speeds), default=0.0)
            for names in (("forwards",), ("backwards",), DRIVES[2:], TURNS)
        ]
        drives = (
            drive._replace(
                speed=min(1.0, self.largest(name) / speed_m_s) if name in speeds else 1.0
            )
            for name, drive in zip(DRIVES, steering.drives, strict=True)
        )
        return config.having(
            "calibrated",
            forward_speed_rad_s=of[0],
            backward_speed_rad_s=of[1],
            side_speed_rad_s=of[2],
            turn_speed_rad_s=of[3],
            max_speed_rad_s=round(self.hop_free_rad_s, 1),
            drives=tuple(drives),
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
