"""Measured stopping distances, from which the shield's margin follows (docs/shield.md).

Robots drive every which way, motors at speeds up to the largest that the steering asks for, changed
at random times, and are stopped at random times.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2

from cosim.base.errors import UserError
from cosim.calibration.trial import Trial
from cosim.coupling.fmu import MotorFmu
from cosim.model.config import CoSimConfig
from cosim.model.world import draw_world
from cosim.onboard.steering import DIRECT, HOLD, MODE, OMEGA_D, OMEGA_E
from cosim.physics.body_state import PLANE
from cosim.physics.properties import gravity

ROBOTS, TRIALS, ROUNDS = 64, 4, 8  # 2048 stops
EXCEEDED, CONFIDENCE = 1e-5, 0.99  # share of the stops that come further, and how sure that is
_TAIL = 0.05  # share of the stops that the bound is extrapolated from
RESERVE = 1.25  # assumed: over that bound, for motion that was not measured
REST_S = 0.1
_DRIVE_S, _CHANGE_S, _TICKS_S, _HELD_S = (0.05, 0.4), 0.2, 0.05, 0.25
_BOUNCING_S = 10.0  # assumed: feet bounce as high as they ever do after this time at one speed
_OPEN_LOOP = 4.0  # times as long, because these motors take as long to speed up and down
_CORNER_M = 0.03
_WIDTHS = 32  # directions in which a path is measured
SLIDES = (
    "robots that are stopped slide {} in this world; leave out --shield, or make the floor less "
    "steep or less slippery"
)


class Stops(NamedTuple):
    """Stops of N robots, n of each."""

    path_m: np.ndarray  # (N, n) diameter of the path from the look before the stop until rest
    rest_s: np.ndarray  # (N, n) time after which a robot moved less than a micrometre
    creep_m_s: np.ndarray  # (N,) mean speed of a robot that is held after the last stop


def stopping_paths(config: CoSimConfig, fmu: MotorFmu, robots: int, seed: int) -> Stops:
    """Measure how far robots come from one look until they rest, if the next look stops them.

    Args:
        config: machine, floor and steering; its world's motor spread and slope are drawn. Where it
            has patches, up to four of their friction coefficients meet near every robot.
        fmu: of the motors.
        robots: how many.
        seed: of what they do, and of the noise.
    """
    rng, sequence = np.random.default_rng(seed), np.random.SeedSequence(seed)
    period_s, steering = config.timing.control_period_s, config.steering
    speeds = steering.turn_speed_rad_s, steering.forward_speed_rad_s, steering.backward_speed_rad_s
    largest = max(steering.max_speed_rad_s, *speeds) + steering.dither_rad_s
    drawn = draw_world(config.world, config.motor, robots, sequence)
    slope = gravity(config.world, drawn, config.motor.g, config.portable)
    headings = rng.uniform(-np.pi, np.pi, robots)
    periods_of_ticks, slower = round(_TICKS_S / period_s), _slower(config)
    with Trial(fmu, config, headings, sequence, motors=drawn.motors, gravity=slope) as trial:
        trial.lay(corners(config, trial.origins_m, rng))
        first, rest = (trial.ticks(n * config.ticks_per_period) for n in (1, periods_of_ticks))
        path_m, rest_s = np.zeros((2, robots, ROUNDS))
        for stop in range(ROUNDS):
            kind = rng.integers(4, size=robots)[:, None]
            trial.commands[:, MODE] = DIRECT
            steady_s = _BOUNCING_S if config.world.restitution and stop == 0 else 0.0
            left = round((slower * rng.uniform(*_DRIVE_S) + steady_s) / period_s)
            before = trial.bodies[PLANE].T.copy()
            while left > 0:
                # Any two speeds; driving; turning; the largest speeds.
                speeds = rng.uniform(-largest, largest, (robots, 2))
                sign = rng.choice([-1.0, 1.0], (robots, 1))
                fast = sign * rng.uniform(0.7, 1.0, (robots, 1)) * largest
                choices = [fast * [-1.0, 1.0], fast * [1.0, 1.0], np.sign(speeds) * largest]
                for number, chosen in enumerate(choices, 1):
                    speeds = np.where(kind == number, chosen, speeds)
                trial.commands[:, OMEGA_D], trial.commands[:, OMEGA_E] = speeds.T
                same_s = slower * rng.uniform(0.0, _CHANGE_S) + steady_s
                periods = min(left, 1 + round(same_s / period_s))
                left, steady_s = left - periods, 0.0
                if periods > 1:
                    trial.advance(periods - 1)
                before = trial.bodies[PLANE].T.copy()
                trial.advance(1, first)
            trial.commands[:, MODE] = HOLD
            at = trial.advance(round(slower * REST_S / period_s), rest).position[:, :, :2]
            ticks = [raw.position[:, :robots, :2] for raw in (first, rest)]
            path_m[:, stop] = path_diameter(np.concatenate([before[None], *ticks, at]))
            restless = np.hypot(*(at - at[-1]).transpose(2, 0, 1)) > 1e-6
            rest_s[:, stop] = period_s * restless.sum(axis=0)
        held = trial.advance(round(_HELD_S / period_s)).position[[0, -1], :, :2]
    return Stops(path_m, rest_s, np.hypot(*(held[1] - held[0]).T) / _HELD_S)


def _slower(config: CoSimConfig) -> float:
    return _OPEN_LOOP if "motors" in config.open_loop else 1.0


def path_diameter(path: np.ndarray) -> np.ndarray:
    """Return an upper bound (N,) on the diameter of paths (n, N, 2), at most 0.2 % above it."""
    angles = np.pi * np.arange(_WIDTHS) / _WIDTHS
    widths = [np.ptp(path @ (np.cos(a), np.sin(a)), axis=0) for a in angles]
    return np.max(widths, axis=0) / math.cos(0.5 * np.pi / _WIDTHS)


def bound_of(path_m: np.ndarray) -> float:
    """Return the length that at most EXCEEDED of all stops exceed, with CONFIDENCE.

    An exponential tail, with the upper limit of its mean, is fitted to how far the longest paths
    exceed a threshold. Measured tails end earlier (docs/shield.md), which makes the bound larger
    than it needs to be.

    Args:
        path_m: (N, n) of N robots; the number of robots in the tail limits how sure its mean is.
    """
    paths = np.sort(path_m, axis=None)
    longest = round(_TAIL * len(paths))
    threshold = paths[-longest - 1]
    robots = max(1, np.count_nonzero((path_m > threshold).any(axis=1)))
    excess = paths[-longest:] - threshold
    tail = max(excess.mean(), excess.std()) * 2.0 * robots
    tail /= chi2.ppf(1.0 - CONFIDENCE, 2 * robots)
    return float(threshold + tail * math.log(_TAIL / EXCEEDED))


def stopping_distance(config: CoSimConfig, fmu: MotorFmu) -> tuple[float, float]:
    """Return the bound on the stopping distance in m, and the creep of held robots in m/s.

    Raises:
        UserError: robots do not come to rest.
    """
    found = [stopping_paths(config, fmu, ROBOTS, seed) for seed in range(TRIALS)]
    if max(stops.rest_s.max() for stops in found) > 0.9 * _slower(config) * REST_S:
        raise UserError(SLIDES.format("on"))
    bound_m = bound_of(np.concatenate([stops.path_m for stops in found]))
    return bound_m, float(max(stops.creep_m_s.max() for stops in found))


def corners(config: CoSimConfig, origins_m: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return a floor (N, P, 5) of its own for each robot, see `State.patches`.

    Where the world has patches, four of their friction coefficients meet at a corner under the
    robot's feet, or close to them; the extremes are as frequent as all others together.
    """
    floors = [config.robot.mu, *(patch.mu for patch in config.world.mu_patches)]
    if len(floors) == 1:
        return np.empty((len(origins_m), 0, 5))
    pool = [*floors, *(len(floors) // 2 * [min(floors), max(floors)])]
    patches = np.empty((len(origins_m), 4, 5))
    x, y = (origins_m + rng.uniform(-_CORNER_M, _CORNER_M, origins_m.shape)).T
    far = np.full(len(x), np.inf)
    quadrants = (-far, -far, x, y), (x, -far, far, y), (-far, y, x, far), (x, y, far, far)
    patches[:, :, :4] = np.array(quadrants).transpose(2, 0, 1)
    patches[:, :, 4] = rng.choice(pool, (len(x), 4))
    return patches
