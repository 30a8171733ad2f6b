"""Find designs that give a robot a desired speed, with all feet on the floor."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from cosim.base.progress import Progress
from cosim.model.preset import PAPER, find_preset
from minirobots.options import CommandOptions, Friction, Positive, PresetName

if TYPE_CHECKING:
    from cosim.machine.platform.design import Design
    from cosim.model.params import RobotParams


class DesignRobot(CommandOptions):
    """Print the motor speed for a robot speed, and designs that keep all feet on the floor at it.

    Results come from closed forms (the 1-DOF platform of Eq. (1) on three feet), and so do the
    changes of the speed with every parameter: eccentric mass, friction, weight, motor speed.
    """

    speed: Annotated[Positive, tyro.conf.arg(metavar="MM_S")]
    """Wanted speed in mm/s."""
    preset: PresetName = PAPER
    mu: Friction = None


def run(options: DesignRobot, _: Progress) -> Iterator[Any]:
    """Work out the design and print it as text."""
    from cosim.machine.platform.design import design

    config = find_preset(options.preset).config().having("given", mu=options.mu)
    found = design(config.robot, config.motor, 1e-3 * options.speed)
    yield found
    print("\n".join(_lines(found, config.robot)))


def _lines(found: "Design", robot: "RobotParams") -> Iterator[str]:
    omega, least = found.motor_speed_rad_s, found.least_unbalance_kg_m
    yield (
        f"As it is (mu {robot.mu:g}, m r {1e6 * found.unbalance_kg_m:.3g} g mm), the robot has all "
        f"feet on the floor up to {1e3 * max(0.0, found.feet_down_m_s):.2f} mm/s, at "
        f"{found.foot_lift_rad_s:.0f} rad/s; it leaves the floor at {found.lift_off_rad_s:.0f}."
    )
    wanted = f"{1e3 * found.speed_m_s:.3g} mm/s"
    if omega is None:
        yield f"It leaves the floor before it reaches {wanted}."
    else:
        feet = "and no foot lifts" if found.feet_stay_down else "but feet lift in every turn"
        yield f"{wanted} takes {omega:.0f} rad/s, {feet}."
    if least is None:
        yield f"No m r from a hundredth to a hundred times its own gives {wanted} with feet down."
    else:
        yield (
            f"With feet down, {wanted} takes an m r of {1e6 * least:.3g} g mm per motor or more "
            f"({least / found.unbalance_kg_m:.3g} times its own), at "
            f"{found.unbalance_motor_speed_rad_s:.0f} rad/s or less."
        )
    if found.foot_radius_m is not None:
        fits = "" if found.foot_radius_m < robot.diameter_m / 2.0 else ", outside the body,"
        yield (
            f"At {omega:.0f} rad/s feet on a circle of {1e3 * found.foot_radius_m:.1f} mm or "
            f"more{fits} stay down (now {1e3 * robot.foot_radius_m:.3g} mm)."
        )
    if found.com_height_m is not None:
        yield (
            f"At {omega:.0f} rad/s they do under a centre of mass no higher than "
            f"{1e3 * found.com_height_m:.1f} mm (now {1e3 * robot.com_height_m:.3g} mm)."
        )
    names = ("m r", "friction", "mass", "motor speed")
    changes = zip(names, found.percent_per_percent.values(), strict=True)
    more = ", ".join(f"{name} {change:+.2f} %" for name, change in changes)
    yield f"Change of the speed for 1 % more: {more}."
