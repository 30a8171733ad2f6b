"""Draw four machines from above, and the paths that they drive by their motion primitives.

`uv run python docs/examples/machines.py docs/images/machines.png`
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from cosim.calibration.measuring import calibrated
from cosim.calibration.trial import Trial
from cosim.fmi.motor import MotorFmu
from cosim.model.config import CoSimConfig
from cosim.model.params import mounts_of
from cosim.model.preset import find_preset
from cosim.physics.contact import feet_of
from cosim.physics.rotation import headings
from docs.examples.draw_machine import machine
from fmus.build import cached_fmu

LEGS = (("forwards", 10.0), ("left_turn", 10.0), ("forwards", 10.0))  # and how long, in s
SPEEDS = {"forwards": "forward_speed_rad_s", "left_turn": "turn_speed_rad_s"}


def driven(config: CoSimConfig, fmu: Path) -> np.ndarray:
    """Return x and y in m and the heading in rad along the legs, (n, 3)."""
    steering, track = config.steering, []
    with Trial(MotorFmu(fmu), config, np.zeros(1), np.random.SeedSequence(0)) as trial:
        for name, seconds in LEGS:
            shares = np.array([getattr(own, name) for own in steering.shares])
            trial.set_motors(getattr(steering, SPEEDS[name]) * shares)
            samples = trial.advance(round(seconds / config.timing.control_period_s))
            places = samples.position[:, 0, :2] - trial.origins_m[0]
            track.append(np.column_stack([places, headings(samples.quaternion[:, 0])]))
    return np.concatenate(track)


def draw(axes: Axes, name: str, config: CoSimConfig, track: np.ndarray) -> None:
    """Draw a machine at the start and at the end of its track, in mm."""
    robot = config.robot
    axes.plot(*(1e3 * track[:, :2].T), color="C1")
    for (x, y, angle), shade in zip(track[[0, -1]], (0.3, 1.0), strict=True):
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        centre = 1e3 * np.array([x, y])
        axes.add_patch(Circle(tuple(centre), 500.0 * robot.diameter_m, fill=False, alpha=shade))
        feet = 1e3 * np.array([(foot.x_m, foot.y_m) for foot in feet_of(robot)]) @ turn.T
        axes.plot(*(centre + feet).T, "o", color="C2", markersize=4, alpha=shade)
        for mount in mounts_of(robot):
            place = 1e3 * np.array(mount.place_m[:2]) @ turn.T + centre
            shaft = 4.0 * np.array(mount.axis[:2]) @ turn.T
            axes.plot(*place, "s", color="C0", markersize=5, alpha=shade)
            axes.plot(*np.array([place - shaft, place + shaft]).T, color="C0", alpha=shade)
    axes.set(title=name, xlabel="mm", aspect="equal")


def main(out: str) -> None:
    """Draw the figure."""
    fmu = cached_fmu()
    with tempfile.TemporaryDirectory() as folder:
        drawn = Path(folder) / "drawn.toml"
        drawn.write_text(machine(1), "utf-8")
        names = {"the paper's robot": "paper", "drawn with seed 1": str(drawn)}
        names |= {"Droplet": "droplet", "Kilobot": "kilobot"}
        configs = {
            name: calibrated(find_preset(given).config(), fmu) for name, given in names.items()
        }
    figure = Figure(figsize=(11.0, 3.2), layout="constrained")
    for axes, (name, config) in zip(figure.subplots(1, 4), configs.items(), strict=True):
        draw(axes, name, config, driven(config, fmu))
    figure.savefig(out, dpi=90)


if __name__ == "__main__":
    main(sys.argv[1])
