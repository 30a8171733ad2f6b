"""Ranges that environments draw a world from in every episode (domain randomisation)."""

import math
from typing import Any

import numpy as np

from agent.moves.worlds import Ranges, draw_world
from cosim.base.arguments import ConfigError, taken
from cosim.model.config import CoSimConfig

_NOTHING = dict.fromkeys(Ranges._fields, (0.0, 0.0)) | {"patches": 0, "patch_cells": (1, 1)}


class WorldRange(Ranges):
    """Ranges of worlds: what is named is drawn, all else is that of the ideal world.

    >>> import agent.envs
    >>> agent.envs.WorldRange(mu=(0.1, 0.26)).motor_spread
    (0.0, 0.0)

    Names and units are those of `agent.moves.worlds.Ranges`; μ is by default that of the machine.
    """

    __slots__ = ()

    def __new__(cls, **ranges: Any) -> "WorldRange":
        """Take the ranges.

        Raises:
            ConfigError: there is no range of that name.
        """
        for name in ranges:
            if name not in cls._fields:
                known = ", ".join(cls._fields)
                raise ConfigError(f"worlds have no range {name}; choose from {known}")
        given: dict[str, Any] = _NOTHING | {"mu": None} | ranges
        return super().__new__(cls, **given)

    def __getnewargs_ex__(self) -> tuple[tuple[()], dict[str, Any]]:
        """Copies and pickles have the same ranges."""
        return (), self._asdict()


def checked_ranges(worlds: Any, config: CoSimConfig) -> Ranges:
    """Return ranges whose worlds all can be, with μ.

    Args:
        worlds: as given to an environment.
        config: of its robots.

    Raises:
        UserError: these are no ranges, or a world at their ends is invalid.
    """
    if not isinstance(worlds, Ranges):
        raise ConfigError(
            f"worlds = {worlds!r} has no ranges; give agent.envs.WorldRange(mu=(0.1, 0.26)), or "
            "agent.envs.ROBUST_WORLDS"
        )
    if worlds.mu is None:
        worlds = worlds._replace(mu=(config.robot.mu, config.robot.mu))
    if taken("worlds.patches", worlds.patches, int) < 0:
        raise ConfigError(f"worlds.patches = {worlds.patches} must not be negative")
    ends: tuple[dict[str, Any], ...] = ({"patches": worlds.patches}, {"patches": worlds.patches})
    for name, value in worlds._asdict().items():
        if name == "patches":
            continue
        low, high = taken(f"worlds.{name}", value, tuple[float, float])
        if not -math.inf < low <= high < math.inf:
            raise ConfigError(f"worlds.{name} = {value} must be ascending and finite")
        # the least payload has no offset, which worlds without a payload refuse
        for end, number in zip(ends, (high if name == "payload_g" else low, high), strict=True):
            end[name] = (number, number)
    for end in ends:
        end["patch_cells"] = tuple(max(1, int(n)) for n in end["patch_cells"])
        config.in_world(draw_world(Ranges(**end), 30, 15, np.random.default_rng(0)))
    return worlds
