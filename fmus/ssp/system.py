"""Systems of FMUs: who is in them, with which parameters, and what is connected; no files."""

from typing import NamedTuple

from fmus.models import Model
from fmus.variables import load_table

MOTORS = ("D", "E")
SHAFT = ("theta", "omega", "omega_dot")
POSE = ("x", "y", "z", "q_w", "q_x", "q_y", "q_z")


class SspComponent(NamedTuple):
    """An FMU in a system.

    Attributes:
        name: in the system.
        model: what the FMU is of.
        values: of inputs and parameters that are not at their start values, in their units.
        shown: outputs that are connectors though nothing is connected to them: some importers
            record connectors alone.
    """

    name: str
    model: Model
    values: dict[str, float | bool]
    shown: tuple[str, ...] = ()


class SspConnection(NamedTuple):
    """From an output of one component to an input of another; both by their names."""

    start: str
    output: str
    end: str
    input: str


class SspSystem(NamedTuple):
    """Components in the order in which they are to step, and what is connected."""

    name: str
    description: str
    components: tuple[SspComponent, ...]
    connections: tuple[SspConnection, ...]


class Robot(NamedTuple):
    """A robot of a system.

    Attributes:
        speeds: set points of motors D and E in rad/s.
        x, y: where it starts, in m.
        heading: at the start in rad.
    """

    speeds: tuple[float, float]
    x: float
    y: float
    heading: float


# One drives forwards, bending to one side, the other one turns on the spot; they never meet.
PAIR = (
    Robot(speeds=(-992.0, 972.0), x=0.05, y=0.05, heading=0.4),
    Robot(speeds=(1015.0, 1005.0), x=0.2, y=0.2, heading=-2.0),
)


def robots_with_motors(
    robots: tuple[Robot, ...] = PAIR, *, motors_first: bool = False
) -> SspSystem:
    """Robots on an open floor, each with its two motors, which are at rest at first.

    Args:
        robots: what each is told, and where it starts.
        motors_first: whether the system is for masters that step one component after the other, in
            their order, instead of all at once.
    """
    components: list[SspComponent] = []
    connections: list[SspConnection] = []
    for k, robot in enumerate(robots, start=1):
        body = f"robot{k}"
        for motor, speed in zip(MOTORS, robot.speeds, strict=True):
            name = f"motor{k}{motor}"
            components.append(SspComponent(name, "VibrationMotor", {"omega_des": speed}))
            fitting = load_table("MiniRobot").terminals[f"motor_{motor}"]
            connections += [SspConnection(name, s, body, fitting[s]) for s in SHAFT]
        start: dict[str, float | bool] = {
            "x_start": robot.x,
            "y_start": robot.y,
            "heading_start": robot.heading,
        }
        if motors_first:
            start["extrapolate"] = False
        components.append(SspComponent(body, "MiniRobot", start, POSE))
    return SspSystem(
        "robots",
        f"{len(robots)} mini-robots, each a body with two vibration motors, on an open floor",
        tuple(components),
        tuple(connections),
    )
