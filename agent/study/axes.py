"""Worlds of the robustness table: one thing at a time that is not ideal, and everything at once."""

from collections.abc import Iterator
from typing import Literal, NamedTuple, get_args

from cosim.model.scenario import Scenario
from cosim.model.world import IDEAL, Patch, Sensor, World

Axis = Literal[
    "everything",
    "nothing",
    "friction",
    "patches",
    "motors",
    "rate",
    "delay",
    "noise",
    "dropout",
    "restitution",
    "payload",
    "tilt",
]
AXES: tuple[Axis, ...] = get_args(Axis)  # the most important ones first


class AxisPoint(NamedTuple):
    """A world of the table.

    Attributes:
        axis: what is not ideal.
        value: how much, as text for the table.
        world: in which it is so.
    """

    axis: Axis
    value: str
    world: World


def _patches(scenario: Scenario, low: float, high: float) -> World:
    """Quarters of the board like a chess board's fields."""
    columns, rows = scenario.columns, scenario.rows
    middle_x, middle_y = columns // 2, rows // 2
    bounds_x = (0, middle_x - 1), (middle_x, columns - 1)
    bounds_y = (0, middle_y - 1), (middle_y, rows - 1)
    return World(
        mu_patches=tuple(
            Patch((left, bottom, right, top), low if i == j else high)
            for i, (left, right) in enumerate(bounds_x)
            for j, (bottom, top) in enumerate(bounds_y)
        )
    )


def _camera(
    rate_hz: float = 30.0,
    delay_ms: float = 50.0,
    position_noise_mm: float = 0.5,
    heading_noise_deg: float = 1.0,
    dropout: float = 0.0,
) -> World:
    """By default the camera of `cosim.model.scenario_file.ROUGH`."""
    sensor = Sensor(rate_hz, delay_ms, position_noise_mm, heading_noise_deg, dropout)
    return World(sensor=sensor)


def points(axis: Axis, scenario: Scenario, everything: World) -> Iterator[AxisPoint]:
    """The worlds of an axis.

    Args:
        axis: what is not ideal.
        scenario: its board.
        everything: the world in which nothing is ideal.
    """
    worlds: dict[Axis, dict[str, World]] = {
        "everything": {"as in its file": everything},
        "nothing": {"the paper's world": IDEAL},
        "friction": {f"µ = {mu:g}": World(mu=mu) for mu in (0.1, 0.2, 0.3, 0.4)},
        "patches": {
            f"µ = {low:g} and {high:g}": _patches(scenario, low, high)
            for low, high in ((0.12, 0.18), (0.1, 0.25))
        },
        "motors": {f"{s:.0%}": World(motor_spread=s) for s in (0.05, 0.1, 0.2)},
        "rate": {f"{hz:g} Hz": _camera(rate_hz=hz) for hz in (60.0, 30.0, 10.0)},
        "delay": {f"{ms:g} ms": _camera(delay_ms=ms) for ms in (0.0, 100.0, 200.0)},
        "noise": {
            f"{mm:g} mm, {deg:g}°": _camera(position_noise_mm=mm, heading_noise_deg=deg)
            for mm, deg in ((0.0, 0.0), (1.5, 2.0), (3.0, 4.0))
        },
        "dropout": {"30 %": _camera(dropout=0.3)},
        "restitution": {f"{e:g}": World(restitution=e) for e in (0.2, 0.5)},
        "payload": {
            f"{g:g} g, 10 mm aside": World(payload_g=g, payload_offset_mm=(0.0, 10.0))
            for g in (5.0, 10.0)
        },
        "tilt": {f"{deg:g}°": World(floor_tilt_deg=deg) for deg in (0.5, 1.0, 2.0)},
    }
    for value, world in worlds[axis].items():
        yield AxisPoint(axis, value, world)
