"""Motion primitives of a machine: the set points of its motors that drive and turn it.

They are found, not given. Robots drive at random set points, many at once; the best ones for each
primitive are refined by linear fits to small changes of them, which also say what turns a driving
robot. Nothing is assumed of the places of motors and feet.
"""

import math
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import msgspec
import numpy as np

from cosim.base.command import workers
from cosim.base.errors import UserError
from cosim.base.progress import Progress, silent
from cosim.calibration.measured import LOAD, key_of, measured, reduced
from cosim.calibration.speed_map import DIRECTIONS, DRIVES, LEAST_M_S, TURNS
from cosim.calibration.trial import FALLEN, Trial, mean_motion, without_falls
from cosim.coupling.master import FallError
from cosim.coupling.signals import Samples
from cosim.fmi.motor import MotorFmu
from cosim.model.config import CoSimConfig
from cosim.model.params import Drive, MotorShares
from cosim.physics.trig import normals

VERSION = 5  # of primitives: raise it when their bits change

LIBRARY, LIBRARY_S = 512, 2.0  # random set points, and how long each is driven
SETTLE_S = 0.5
FASTEST = 0.97  # set point, as a share of the largest speed
SLOWEST, FAST = 0.5, 0.9  # the slowest of one half of the library and of the other, over that
OFF_SHARE = 0.25  # of its motors that have none
CHANGES, CHANGES_S = 32, 2.0  # around the best set points
FINALISTS, TRIES = 4, 6  # of every round, driven again: one drive may have been a lucky one
SPREADS = (0.06, 0.02, 0.01)  # of these changes, as shares of the largest speed, round by round
TOGETHER = 16  # robots in a thread
REPEATS, REPEATS_S = 12, 5.0  # with other noise, of what is found
# Of a 95 % interval of a mean, over the spread: the 97.5 % quantile with 11 degrees of freedom
_HALF_WIDTH = 2.201 / math.sqrt(REPEATS)
STARTS = 6  # set points of the library that are tried for longer, for each primitive
ASIDE = 2.0  # what a motion aside costs, over what one ahead is worth
WIDEST = 10.0  # diameters: the largest radius of a curve that counts as a turn
LEAST_CHANGE = 0.5  # of the yaw rate that a difference shall give: below, there is no difference
TURNING_1_S = 2.0  # assumed: yaw rate of a driving robot per heading error, as the paper's has it
LARGEST_SHARE = 0.1  # of the largest speed: bound on the difference that turns a driving robot
LEAST_RAD_S = 0.005  # below, a machine counts as not turning
NO_GAIN = 1e-6  # in place of that of a difference that was not found


class Primitive(msgspec.Struct, frozen=True):
    """A motion primitive, and how well it repeats itself."""

    set_points_rad_s: tuple[float, ...]  # of the motors
    mean: tuple[float, float, float]  # speeds ahead and to the left in m/s, yaw rate in rad/s
    spread: tuple[float, float, float]  # standard deviations of these between drives of REPEATS_S
    airborne_share: float  # largest share of time without a foot on the floor
    # Change of the set points that turns the robot counter-clockwise and changes nothing else, its
    # largest part 1
    difference: tuple[float, ...]
    yaw_gain: float  # yaw rate that 1 rad/s of it gives


class _Search:
    """Drives of one machine."""

    def __init__(self, config: CoSimConfig, fmu: MotorFmu) -> None:
        self.config, self._fmu = config, fmu
        self.top = FASTEST * np.array(config.top_speeds_rad_s)  # of each motor
        self.reach_m = 0.5 * config.robot.diameter_m
        self._drives = 0
        self.aside = ASIDE
        self.fall: FallError | None = None  # the last one

    def drive(self, set_points: np.ndarray, seconds: float) -> np.ndarray:
        """Drive robots at their set points (T, N).

        Returns:
            (T, 4) mean speeds ahead and to the left and yaw rate times the robot's radius, all in
            m/s, and the share of time in the air; 0 and FALLEN of robots that fall.
        """
        self._drives += 1
        parts = [set_points[k : k + TOGETHER] for k in range(0, len(set_points), TOGETHER)]
        keys = ((self._drives, k) for k in range(len(parts)))
        seeds = (np.random.SeedSequence(0, spawn_key=key) for key in keys)
        with ThreadPoolExecutor(workers(-1)) as threads:
            found = threads.map(partial(self._drive, seconds=seconds), parts, seeds)
            return np.concatenate(list(found))

    def _drive(
        self, set_points: np.ndarray, seed: np.random.SeedSequence, seconds: float
    ) -> np.ndarray:
        config, period_s = self.config, self.config.timing.control_period_s

        def drive(driven: np.ndarray) -> tuple[np.ndarray, Samples]:
            with Trial(self._fmu, config, np.zeros(len(driven)), seed) as trial:
                trial.set_motors(driven)
                trial.advance(round(SETTLE_S / period_s))
                return trial.poses, trial.advance(round(seconds / period_s))

        (before, samples), falls = without_falls(drive, set_points)
        self.fall = falls[-1] if falls else self.fall
        motion = mean_motion(before, [samples], period_s)
        motion[:, 2] *= self.reach_m
        found = np.column_stack([motion, samples.airborne_share.mean(axis=0)])
        found[[error.column for error in falls]] = 0.0, 0.0, 0.0, FALLEN
        return found

    def score(self, motion: np.ndarray, towards: np.ndarray) -> np.ndarray:
        """Speed in a direction less `aside` times that in the others; -1 if unusable."""
        along = motion[:, :3] @ towards
        aside = np.abs(motion[:, :3] - np.outer(along, towards)).sum(axis=1)
        return np.where(self.usable(motion), along - self.aside * aside, -1.0)

    def usable(self, motion: np.ndarray) -> np.ndarray:
        """Return which robots (T,) kept standing, and did not hop unless they may."""
        share = motion[:, 3]
        return (share == 0.0) | (self.config.hops & (share < FALLEN))

    def refined(self, best: np.ndarray, towards: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Search near set points for better ones.

        Returns:
            The set points; and (4, N) slopes of a linear fit: by how much 1 rad/s more at each of N
            motors changes the motion (three numbers) and the share of time in the air.
        """
        rng = np.random.default_rng(len(best))
        moving = best != 0.0
        slopes = np.zeros((4, len(best)))
        for spread in SPREADS:
            drawn = normals(rng.random((CHANGES, 2 * len(best))))[:, : len(best)]
            changes = spread * self.top * drawn * moving
            tried = np.clip(best + changes, -self.top, self.top)
            tried[0] = best
            motion = self.drive(tried, CHANGES_S)
            design = np.column_stack([np.ones(CHANGES), (tried - best)[:, moving]])
            stood = motion[:, 3] < FALLEN
            fit = np.linalg.lstsq(design[stood], motion[stood], rcond=None)[0]
            fitted = np.zeros_like(slopes)
            fitted[:, moving] = fit[1:].T
            slopes = fitted if spread == SPREADS[0] else slopes  # of large changes: the surest
            # What the fit says has no motion aside, as near as can be; and a step ahead of it.
            across = np.eye(3) - np.outer(towards, towards)
            constraint, offset = across @ fitted[:3], across @ fit[0, :3]
            cure = -np.linalg.pinv(constraint, rcond=1e-3) @ offset
            ahead = towards @ fitted[:3]
            ahead = ahead - np.linalg.pinv(constraint, rcond=1e-3) @ (constraint @ ahead)
            ahead *= spread * self.top.max() / max(float(np.abs(ahead).max()), 1e-30)
            candidates = [best + cure, best + cure + ahead, best + 0.5 * cure, *tried]
            # Linear algebra rounds otherwise on other processors: fewer digits hide that.
            candidates = np.clip(np.round(candidates, 1), -self.top, self.top)
            measured = np.concatenate([self.drive(candidates[:3], CHANGES_S), motion])
            finalists = candidates[np.argsort(self.score(measured, towards))[-FINALISTS:]]
            again = self.drive(np.repeat(finalists, TRIES, axis=0), CHANGES_S)
            scores = self.score(again, towards).reshape(FINALISTS, TRIES)
            best = finalists[int((scores.mean(axis=1) - scores.std(axis=1)).argmax())]
        return best, slopes

    def primitive(self, set_points: np.ndarray, slopes: np.ndarray) -> Primitive:
        """Measure what set points do, again and again; nothing if a robot falls meanwhile."""
        motion = self.drive(np.tile(set_points, (REPEATS, 1)), REPEATS_S)
        motion[:, 2] /= self.reach_m
        if (motion[:, 3] == FALLEN).any():
            motion[:, :3] = 0.0
        wanted = np.array([0.0, 0.0, self.reach_m])
        turning = np.linalg.pinv(slopes[:3], rcond=1e-3) @ wanted
        if (slopes[:3] @ turning)[2] < LEAST_CHANGE * self.reach_m:
            turning[:] = 0.0  # what it gives is mostly another motion
        largest = max(float(np.abs(turning).max()), 1e-30)
        mean, spread = motion[:, :3].mean(axis=0), motion[:, :3].std(axis=0, ddof=1)
        return Primitive(
            tuple(np.round(set_points, 1).tolist()),
            tuple(mean.tolist()),
            tuple(spread.tolist()),
            float(motion[:, 3].max()),
            tuple(np.round(turning / largest, 6).tolist()),
            float(f"{1.0 / largest:.6g}"),
        )


def search(
    config: CoSimConfig, motor_fmu: Path, progress: Progress = silent
) -> dict[str, Primitive]:
    """Find the primitives of a machine: what it can do of DIRECTIONS, else its best try."""
    run, motors = _Search(config, MotorFmu(motor_fmu)), len(config.robot.motors)
    rng = np.random.default_rng(0)
    least = np.where(np.arange(LIBRARY) % 2, SLOWEST, FAST)[:, None]
    sizes = rng.uniform(least, 1.0, (LIBRARY, motors))
    library = run.top * sizes * rng.choice((-1.0, 1.0), sizes.shape)
    if motors > 1:
        library[rng.random(sizes.shape) < OFF_SHARE] = 0.0
    task, rounds = "finding motion primitives", 1 + len(DIRECTIONS)
    progress(task, 0, rounds)
    motion = run.drive(library, LIBRARY_S)
    if not (run.usable(motion) & library.any(axis=1)).any():
        hops = "its feet leave the floor in all of them; make it heavier, or its motors weaker"
        raise UserError(
            f"machine {config.preset} cannot drive at any of {LIBRARY} set points that were tried: "
            f"{run.fall or hops}"
        )
    found = {}
    for number, (name, direction) in enumerate(DIRECTIONS.items(), 1):
        progress(task, number, rounds)
        towards = np.array(direction)
        # Where nothing turns it on the spot, what turns it fastest while it drives.
        for run.aside in (ASIDE, 0.0) if name in TURNS else (ASIDE,):
            # Set points that do the opposite are good ones, too, with all signs changed.
            best = [np.argsort(run.score(motion, way))[-STARTS:] for way in (towards, -towards)]
            starts = np.concatenate([library[best[0]], -library[best[1]]])
            best = starts[int(run.score(run.drive(starts, CHANGES_S), towards).argmax())]
            found[name] = run.primitive(*run.refined(best, towards))
            if able(found[name], name, run.reach_m):
                break
    progress(task, rounds, rounds)
    return found


def find_primitives(
    config: CoSimConfig, motor_fmu: Path, progress: Progress = silent, *, again: bool = False
) -> dict[str, Primitive]:
    """The primitives of a configuration: found in the cache, or searched for and kept there."""
    pulses = ("pulse_s", "pause_s")
    key = key_of("primitives", VERSION, reduced(config, LOAD), motor_fmu, steering=pulses)
    make = partial(search, config, motor_fmu, progress)
    return measured(key, dict[str, Primitive], make, again=again)


def primitive_rows(found: dict[str, Primitive], config: CoSimConfig) -> list[tuple[str, ...]]:
    """Rows of a table: name, means with 95 % intervals and spread, share in the air, set points."""
    rows = []
    for name, primitive in found.items():
        units = (1e3, 1e3, math.degrees(1.0))
        motion = (
            f"{unit * mean:.2f} ± {unit * _HALF_WIDTH * spread:.2f} (σ {unit * spread:.2f})"
            for unit, mean, spread in zip(units, primitive.mean, primitive.spread, strict=True)
        )
        note = "" if able(primitive, name, 0.5 * config.robot.diameter_m) else ": cannot"
        if note and name in TURNS and (radius_m := curve_m(primitive, name, config)):
            note = f" in a circle of {1e3 * radius_m:.0f} mm"
        speeds = " ".join(f"{value:.0f}" for value in primitive.set_points_rad_s)
        label = name.replace("_", " ") + note
        rows.append((label, *motion, f"{primitive.airborne_share:.1%}", speeds))
    return rows


def able(primitive: Primitive, name: str, reach_m: float) -> bool:
    """Return whether a primitive mainly moves the robot in its direction."""
    towards = np.array(DIRECTIONS[name])
    mean = np.array(primitive.mean) * (1.0, 1.0, reach_m)
    along = float(mean @ towards)
    aside = float(np.abs(mean - along * towards).max())
    least = LEAST_M_S if name in DRIVES else LEAST_RAD_S * reach_m
    return along > max(least, 2.0 * aside)


def curve_m(primitive: Primitive, name: str, config: CoSimConfig) -> float:
    """Radius of the circle in which a turn that is none on the spot drives; 0 if it is no turn."""
    rate = float(np.array(primitive.mean) @ DIRECTIONS[name])
    radius_m = math.hypot(*primitive.mean[:2]) / max(rate, LEAST_RAD_S)
    return radius_m if radius_m < WIDEST * config.robot.diameter_m else 0.0


def steered(config: CoSimConfig, found: dict[str, Primitive]) -> CoSimConfig:
    """Return a configuration whose steering has the primitives of its machine.

    A machine that cannot drive back turns around, and one that cannot turn on the spot drives in
    curves. One that cannot drive ahead, or cannot turn both ways, raises a UserError.
    """
    reach_m = 0.5 * config.robot.diameter_m
    can = {name for name, primitive in found.items() if able(primitive, name, reach_m)}
    radius_m = 0.0
    if not can.issuperset(TURNS) and all(radii := [curve_m(found[n], n, config) for n in TURNS]):
        radius_m, can = max(radii), can.union(TURNS)
        wide = {"lookahead_m": 2.0 * radius_m, "least_lookahead_m": radius_m}
        config = config.having("computed: of the circle in which it turns", **wide)
    if not {"left_turn", "right_turn", "forwards"} <= can:
        raise UserError(_cannot(config.preset, found, can))
    # With the sides but not backwards, the robot's heading would not follow from its last move.
    if not {"backwards", "leftwards", "rightwards"} <= can:
        can -= {"leftwards", "rightwards"}
    speeds = {n: float(np.abs(found[n].set_points_rad_s).max()) for n in DIRECTIONS}
    for pair in (("leftwards", "rightwards"), ("left_turn", "right_turn")):  # share a speed
        speeds |= dict.fromkeys(pair, max(speeds[name] for name in pair))
    speeds |= dict.fromkeys(DIRECTIONS.keys() - can, 0.0)
    none = np.zeros(len(config.robot.motors))
    shares = (
        np.array(found[n].set_points_rad_s) / speeds[n] if n in can else none for n in DIRECTIONS
    )
    rows = zip(*shares, strict=True)
    along = {n: abs(float(np.array(found[n].mean) @ DIRECTIONS[n])) for n in DIRECTIONS if n in can}
    speed_m_s = float(np.mean([along[n] for n in DRIVES if n in can]))
    rate = np.mean([value for name, value in along.items() if name not in DRIVES])
    gains = {n: p.yaw_gain if any(p.difference) else NO_GAIN for n, p in found.items()}
    gain = gains["forwards"]
    drives = (
        Drive(along[n] / speed_m_s, gains[n] / gain, found[n].difference)
        if n in can
        else Drive(difference=tuple(none.tolist()))
        for n in DRIVES
    )
    top = FASTEST * config.top_speed_rad_s
    return config.having(
        "found, see docs/steering.md",
        shares=tuple(MotorShares(*map(float, row)) for row in rows),
        drives=tuple(drives),
        forward_speed_rad_s=speeds["forwards"],
        backward_speed_rad_s=speeds["backwards"],
        side_speed_rad_s=speeds["leftwards"],
        turn_speed_rad_s=speeds["left_turn"],
        turn_radius_m=radius_m,
        max_speed_rad_s=top,
        drive_speed_m_s=config.steering.drive_speed_m_s or speed_m_s,
        turn_rate_rad_s=config.steering.turn_rate_rad_s or float(rate),
        yaw_gain=gain,
        heading_gain_1_s=TURNING_1_S / gain,
        max_difference_rad_s=LARGEST_SHARE * top,
        dither_rad_s=0.0,
    )


def _cannot(machine: str, found: dict[str, Primitive], can: set[str]) -> str:
    """Return the message that refuses a machine which cannot navigate."""
    lacking = [name for name in ("forwards", "left_turn", "right_turn") if name not in can]
    best = max(found.values(), key=lambda p: math.hypot(*p.mean[:2]))
    speed, rate = 1e3 * math.hypot(*best.mean[:2]), math.degrees(best.mean[2])
    falls = any(found[name].airborne_share == FALLEN for name in lacking)
    return (
        f"machine {machine} cannot steer: found nothing that mainly does "
        f"{', '.join(lacking).replace('_', ' ')}"
        f"{', which it does not do without falling over' if falls else ''}; the fastest of the "
        f"best tries is {speed:.2f} mm/s with {rate:+.1f} °/s at set points "
        f"{', '.join(f'{value:.0f}' for value in best.set_points_rad_s)} rad/s; change motors or "
        "feet, or command its set points by a policy that has drive(motion) or by Drive-v0 with "
        "action = motors (docs/environments.md)"
    )
