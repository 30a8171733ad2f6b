"""Worlds that are not ideal: floor, motors, load and camera as they are on a real table.

A `World` is what the table `[world]` of a file declares; the default is the paper's. What differs
from episode to episode is drawn from it with the episode's seed.
"""

from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta

from cosim.base.arguments import validate_fields
from cosim.base.errors import UserError
from cosim.model.params import Quantity, motor_names

Rectangle = tuple[int, int, int, int]  # first column, first row, last column, last row, inclusive

_MAX_PATCHES = 1000  # the dynamics look at one by one


Tree = dict[str, tuple[Any, str]]  # values of parameters and their sources, by name
_Friction = Annotated[float, Meta(ge=0.0, le=10.0)]
_Share = Annotated[float, Meta(ge=0.0, le=1.0)]
_Angle = Annotated[float, Meta(ge=-360.0, le=360.0)]
_Offset = Annotated[float, Meta(ge=-1000.0, le=1000.0)]


def tree_of(source: str, /, **values: Any) -> Tree:
    """Return values of parameters, by name, with one source; None is none."""
    return {name: (value, source) for name, value in values.items() if value is not None}


class Patch(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Cells of the floor with a friction coefficient of their own; later patches cover earlier."""

    cells: Rectangle
    mu: _Friction

    def __post_init__(self) -> None:
        validate_fields(self, "world.mu_patches.")


class Sensor(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The camera over the board; at a rate of 0 poses are known exactly, every control period."""

    rate_hz: Annotated[
        float,
        Meta(ge=0.0, le=1000.0),
        Quantity("Hz", "ideal", "frames of the camera per second, 0: exact poses"),
    ] = 0.0
    delay_ms: Annotated[
        float, Meta(ge=0.0, le=2000.0), Quantity("ms", "ideal", "from a frame to its poses")
    ] = 0.0
    position_noise_mm: Annotated[
        float,
        Meta(ge=0.0, le=100.0),
        Quantity("mm", "ideal", "standard deviation of x and of y in a frame"),
    ] = 0.0
    heading_noise_deg: Annotated[
        float,
        Meta(ge=0.0, le=90.0),
        Quantity("deg", "ideal", "standard deviation of the heading in a frame"),
    ] = 0.0
    dropout: Annotated[
        float,
        Meta(ge=0.0, le=0.99),
        Quantity("1", "ideal", "share of the frames in which a robot is not found"),
    ] = 0.0

    def __post_init__(self) -> None:
        validate_fields(self, "world.sensor.")
        for name in self.__struct_fields__:
            if self.rate_hz == 0.0 and getattr(self, name):
                raise UserError(
                    f"world.sensor.{name} has no effect without a camera; give its rate_hz"
                )


_NO_CAMERA = Sensor()


class World(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A world as declared; None where the machine's value applies.

    >>> import minirobots as mr
    >>> mr.World(mu=0.2, mu_patches=[{"cells": (10, 0, 19, 29), "mu": 0.3}]).mu_patches[0].mu
    0.3

    Attributes:
        motor_speed_noise: half width of the uniform noise on measured speeds over the set point.
        payload_offset_mm: of the payload, forwards and to the left of the robot's axis.
        motor_phases_deg: angles at which the motors begin, r1.D, r1.E, r2.D and so on; 0, and by
            default all, with the eccentric mass straight down.
        obstacles: cells [x, y] and rectangles that stand on the floor as well.
        edge: by default the board is a part of a larger floor, and feet beyond it stand.
    """

    mu: _Friction | None = None
    mu_patches: Annotated[
        tuple[Patch, ...],
        Meta(max_length=_MAX_PATCHES),
        Quantity("", "default", "cells with another mu"),
    ] = ()
    motor_spread: Annotated[
        Annotated[float, Meta(ge=0.0, le=0.3)] | None,
        Quantity("1", "ideal", "relative standard deviation of K_T, R, J and m r"),
    ] = None
    motor_speed_noise: _Share | None = None
    restitution: Annotated[
        _Share | None, Quantity("1", "ideal", "Newton's impact law at the feet")
    ] = None
    floor_tilt_deg: Annotated[
        float, Meta(ge=0.0, le=20.0), Quantity("deg", "ideal", "slope of the floor")
    ] = 0.0
    payload_g: Annotated[
        float,
        Meta(ge=0.0, le=1000.0),
        Quantity("g", "ideal", "on every robot, at the height of its centre of mass"),
    ] = 0.0
    payload_offset_mm: Annotated[
        tuple[_Offset, _Offset], Quantity("", "default", "forwards and to the left")
    ] = (0.0, 0.0)
    motor_phases_deg: Annotated[
        tuple[_Angle, ...], Quantity("", "default", "initial phases of the motors")
    ] = ()
    sensor: Sensor | None = None
    obstacles: tuple[tuple[int, ...], ...] = ()
    edge: Annotated[bool, Quantity("", "ideal", "whether there is no floor beyond the board")] = (
        False
    )

    def __post_init__(self) -> None:
        validate_fields(self, "world.")
        if any(self.payload_offset_mm) and not self.payload_g:
            raise UserError(
                "world.payload_offset_mm has no effect without a payload; give payload_g"
            )

    def tree(self, source: str = "world") -> Tree:
        """Return the values that this world states, obstacles excepted, with their source."""
        names = [n for n in self.__struct_fields__ if getattr(self, n) != getattr(IDEAL, n)]
        own = {n: getattr(self, n) for n in names if n not in ("sensor", "obstacles")}
        camera = {} if self.sensor is None else msgspec.structs.asdict(self.sensor)
        found = {parameter_name("world", name): value for name, value in own.items()}
        found |= {parameter_name("world.sensor", name): value for name, value in camera.items()}
        return tree_of(source, **found)

    @property
    def draws(self) -> bool:
        """Return whether episodes draw anything."""
        return bool(self.motor_spread) or self.floor_tilt_deg > 0.0

    @property
    def camera(self) -> Sensor:
        """The camera; exact poses where nothing is said of one."""
        return self.sensor or _NO_CAMERA


IDEAL = World()  # the paper's


def parameter_name(table: str, name: str) -> str:
    """Return the parameter that a field of a table of a preset or a world is."""
    if table == "world.sensor":
        return f"sensor_{name}"
    return "relative_amplitude" if name == "motor_speed_noise" else name


def motor_phases(world: World, robots: int, motors: int) -> np.ndarray:
    """(N, motors) rad at which motors begin, 0 hanging; NaN where the world says nothing."""
    phases_deg = world.motor_phases_deg
    if not phases_deg:
        return np.full((robots, motors), np.nan)
    if len(phases_deg) != robots * motors:
        names = ", ".join(f"r1.{name}" for name in motor_names(motors))
        raise UserError(
            f"world.motor_phases_deg has {len(phases_deg)} angles, but the robots have "
            f"{robots * motors} motors; give one for each of {names}, r2..."
        )
    return np.radians(phases_deg).reshape(robots, motors)
