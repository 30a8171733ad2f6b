"""Forces, friction and motion over one turn of the motors, from a burst of a recording.

The paper has no such figure. A burst holds speeds, contact forces and positions at every tick; the
angles that a burst may lack are those of the slower samples, continued with the speeds.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from analysis.figures.style import WIDTH_IN, Drawing, figure
from analysis.reading.findings import sliding
from analysis.reading.results import recordings
from cosim.base.colours import BLACK, BLUE, GREEN, GREY, ORANGE, VERMILION
from cosim.base.errors import UserError
from cosim.physics.forces import MotorMount, directions, motor_force
from cosim.recording.reader import Episode, read_episode

# A robot drives straight where its motors turn against each other, each within this share of the
# forward speed; it turns on the spot where they turn alike.
STEADY = 0.15
# Loads are means over this time: a foot that lands has an impulse, not a force of its own.
MEAN_S = 1e-4


class Cycle(NamedTuple):
    """One turn of motor D while a robot drives; n ticks."""

    robot: str
    time_s: np.ndarray  # (n,)
    theta: np.ndarray  # (n, 2) angles of D and E, rad
    omega: np.ndarray  # (n, 2) speeds of D and E, rad/s
    # Mean angle between the masses; 0 where they push together, π where they cancel
    apart_rad: float
    driving_n: np.ndarray  # (n,) force of both eccentric masses along the body's x axis, Eq. (3)
    friction_n: np.ndarray  # (n,) friction of all feet along it, mean over MEAN_S
    holds_n: np.ndarray  # (n,) largest friction that the feet's load allows, likewise
    normal_n: np.ndarray  # (n, 3) load of feet A, B, C, likewise
    impact_n_s: float  # largest normal impulse with which a foot lands
    lifted: np.ndarray  # (n, 3) bool, feet that carry nothing
    slides: np.ndarray  # (n, 3) bool, feet that slide
    ahead_m: np.ndarray  # (n,) distance along the body's x axis since the first tick


def find_cycle(episode: Episode) -> Cycle:
    """The turn, of all in the episode's bursts in which a robot drives, with masses most in step.

    Nothing keeps the motors in step: their masses drift between pushing together and against each
    other, and what a turn looks like depends on it.
    """
    cycles = [cycle for robot in episode.robots for cycle in _cycles(episode, robot)]
    if not cycles:
        raise UserError(
            f"{episode.origin}: no burst holds a whole turn of the motors in which a robot drives; "
            "record a longer episode"
        )
    return min(cycles, key=lambda cycle: cycle.apart_rad)


def _cycles(episode: Episode, robot: str) -> Iterator[Cycle]:
    """The last whole turn of every burst in which a robot drives straight on."""
    raw, dt_s = episode.signals[f"/raw/{robot}/omega"], episode.parameter("dt_s")
    speed = episode.parameter("forward_speed_rad_s")
    edges = np.flatnonzero(np.diff(raw.time_s) > 1.5 * dt_s) + 1
    for burst in np.split(np.arange(len(raw.time_s)), edges):
        omega = raw.values[burst]
        steady = np.abs(np.abs(omega) / speed - 1.0).max() < STEADY
        if not steady or omega[0, 0] * omega[0, 1] > 0.0:
            continue
        theta = _angles(episode, robot, raw.time_s[burst], omega, dt_s)
        if theta is None:
            continue
        whole = np.flatnonzero(np.abs(theta[:, 0] - theta[-1, 0]) >= 2.0 * np.pi)
        if len(whole):
            motion = theta, omega, np.gradient(omega, dt_s, axis=0)
            yield _cycle(episode, robot, burst[whole[-1] :], *(v[whole[-1] :] for v in motion))


def _cycle(episode: Episode, robot: str, rows: np.ndarray, *motion: np.ndarray) -> Cycle:
    """Return a turn by its n rows in the bursts; `motion` as of `_driving_force`."""
    raw = (episode.signals[f"/raw/{robot}/{name}"] for name in ("friction", "normal", "position"))
    friction, normal, position = (
        s._replace(time_s=s.time_s[rows], values=s.values[rows]) for s in raw
    )
    load, time_s, path = normal.values, position.time_s, position.values[:, :2]
    mu, dt_s = episode.parameter("mu"), episode.parameter("dt_s")
    headings = episode.signals[f"/sim/{robot}/heading"]
    heading = headings.values[np.argmin(np.abs(headings.time_s - time_s[0]))]
    theta, omega, _ = motion
    landed = (load[:-2] == 0.0) & (load[1:-1] > 0.0)
    impacts = np.where(landed, load[1:-1] + load[2:], 0.0)  # of two ticks
    return Cycle(
        robot,
        time_s,
        theta,
        omega,
        abs(float(np.angle(np.exp(1j * theta.sum(axis=1)).mean()))),
        _driving_force(episode, *motion),
        _mean(friction.values[:, ::2].sum(axis=1), dt_s),
        _mean(mu * load.sum(axis=1), dt_s),
        np.apply_along_axis(_mean, 0, load, dt_s),
        float(impacts.max(initial=0.0)) * dt_s,
        load == 0.0,
        sliding(friction, normal, mu),
        (path - path[0]) @ [np.cos(heading), np.sin(heading)],
    )


def _mean(values: np.ndarray, dt_s: float) -> np.ndarray:
    """Values (n,) at every tick of dt_s, averaged over MEAN_S around each."""
    count = max(1, round(MEAN_S / dt_s))
    window = np.ones(count)
    return np.convolve(values, window, "same") / np.convolve(np.ones(len(values)), window, "same")


def _angles(
    episode: Episode, robot: str, time_s: np.ndarray, omega: np.ndarray, dt_s: float
) -> np.ndarray | None:
    """Angles at a burst's ticks, (n, 2) rad; None if they are not known where it begins."""
    recorded = episode.signals.get(f"/raw/{robot}/theta")
    if recorded is not None:
        return recorded.values[np.searchsorted(recorded.time_s, time_s)]
    slow = episode.signals[f"/sim/{robot}/motors/theta"]
    before = np.flatnonzero(np.abs(slow.time_s - (time_s[0] - dt_s)) < 0.5 * dt_s)
    if not len(before):
        return None
    return slow.values[before[0]] + dt_s * np.cumsum(omega, axis=0)


def _driving_force(episode: Episode, *motion: np.ndarray) -> np.ndarray:
    """Return the force (n,) along x by angles, speeds and accelerations (n, 2) of D and E."""
    m, r, inertia, g = (episode.parameter(name) for name in ("m", "r", "J", "g"))
    total = np.zeros(len(motion[0]))
    for motor, sin_phi in enumerate((1.0, -1.0)):
        # only the force along x counts
        axis = (0.0, sin_phi, 0.0)
        mount = MotorMount(
            m, r, inertia, g, 0.0, 0.0, 0.0, 0.0, axis, *directions(axis), across=True
        )
        states = zip(*(values[:, motor] for values in motion), strict=True)
        total += [motor_force(mount, *map(float, state))[0] for state in states]
    return total


def draw(cycle: Cycle) -> Figure:
    """Forces, loads, speeds and distance over the angle of motor D."""
    figure, grid = plt.subplots(2, 2, figsize=(WIDTH_IN, 4.4), sharex=True)
    direction = np.sign(cycle.omega[0, 0])
    degrees = np.rad2deg(direction * cycle.theta[:, 0])
    degrees -= 360.0 * np.floor(degrees[0] / 360.0)
    (force, load), (speed, distance) = grid
    force.fill_between(
        degrees, -cycle.holds_n, cycle.holds_n, color=GREY, alpha=0.3, lw=0, label="friction holds"
    )
    force.plot(degrees, cycle.driving_n, color=BLACK, label="driving force")
    force.plot(degrees, cycle.friction_n, color=VERMILION, label="friction")
    force.set(ylabel="force along x in N")
    for name, values, colour in zip("ABC", cycle.normal_n.T, (BLUE, ORANGE, GREEN), strict=True):
        load.plot(degrees, values, color=colour, label=f"foot {name}")
    load.set(ylabel=f"normal force in N,\nmean over {1e3 * MEAN_S:g} ms")
    for name, values, colour in zip("DE", np.abs(cycle.omega).T, (BLUE, VERMILION), strict=True):
        speed.plot(degrees, values, color=colour, label=f"motor {name}")
    speed.set(ylabel="speed in rad/s")
    distance.plot(degrees, 1e6 * cycle.ahead_m, color=BLUE)
    distance.set(ylabel="distance ahead in µm")
    for axes in (force, load, speed):
        low, high = axes.get_ylim()
        axes.set_ylim(low, high + 0.35 * (high - low))  # room for the legend
        axes.legend(loc="upper right", ncols=3, columnspacing=1.0, handlelength=1.5)
    ticks = np.arange(90.0 * np.ceil(degrees[0] / 90.0), degrees[-1] + 1e-6, 90.0)
    for axes in (speed, distance):
        axes.set_xlabel("angle of motor D in degrees")
        axes.set_xticks(ticks, [f"{tick % 360.0:.0f}" for tick in ticks])
    return figure


def drawing_of(cycle: Cycle) -> Drawing:
    """Return the figure of one turn."""
    numbers = {
        "omega_rad_s": float(np.abs(cycle.omega).mean()),
        "apart_rad": cycle.apart_rad,
        "turn_s": float(cycle.time_s[-1] - cycle.time_s[0]),
        "step_um": 1e6 * float(cycle.ahead_m[-1]),
        "sliding_share": float(cycle.slides.mean()),
        "lifted_share": float(cycle.lifted.any(axis=1).mean()),
        "driving_max_n": float(np.abs(cycle.driving_n).max()),
        "friction_limit_min_n": float(cycle.holds_n.min()),
        "impact_max_n_s": cycle.impact_n_s,
    }
    apart_deg, turn_ms = np.rad2deg(cycle.apart_rad), 1e3 * numbers["turn_s"]
    sentences = (
        f"At {{omega_rad_s:.0f}} rad/s, with masses {apart_deg:.0f}° from pushing together, a turn "
        f"takes {turn_ms:.2f} ms and moves the robot {{step_um:.1f}} µm.",
        "The masses push with up to {driving_max_n:.2f} N, the friction that the load allows falls "
        "to {friction_limit_min_n:.3f} N; the feet slide in {sliding_share:.0%} of the ticks, and "
        "some foot is in the air in {lifted_share:.0%}. Feet land with up to "
        f"{1e6 * cycle.impact_n_s:.0f} µN s.",
    )
    return Drawing(
        draw(cycle),
        tuple(sentence.format(**numbers) for sentence in sentences),
        numbers,
        words={"robot": cycle.robot, "time_s": cycle.time_s[0]},
    )


@figure(
    "motor_cycle",
    "Robot {robot} driving at {time_s:.3f} s of a recorded episode of scenario 2, every tick "
    "of one turn of its motors",
    claim=(
        "above a critical motor speed the forces of the eccentric masses overcome friction at the "
        "contact points, and the robot slides (it has no such figure)."
    ),
    inputs=("episodes_2_moves",),
)
def make(results: Path) -> Drawing:
    """Draw the figure of a results folder."""
    return drawing_of(find_cycle(read_episode(recordings("episodes_2_moves", results)[0])))
