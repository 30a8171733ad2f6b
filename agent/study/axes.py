"""Worlds of the robustness table: one thing at a time that is not ideal, and everything at once."""

from collections.abc import Iterator
from pathlib import Path
from typing import Literal, get_args

import msgspec

from cosim.base.arguments import validate_argument
from cosim.base.reading import Kind, read_toml
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import ROUGH, read_world
from cosim.model.world import World

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
_WORLDS = Path(__file__).with_name("robustness.toml")


def worlds_of(axis: str, scenario: Scenario, everything: World) -> Iterator[tuple[str, World]]:
    """Return how much is not ideal on an axis, as text for the table, and the world of it.

    Args:
        axis: what is not ideal.
        scenario: its board.
        everything: the world in which nothing is ideal.
    """
    camera = msgspec.to_builtins(read_world(ROUGH).sensor)
    columns, rows = scenario.columns, scenario.rows
    quarters = [
        (left, bottom, right, top)
        for left, right in ((0, columns // 2 - 1), (columns // 2, columns - 1))
        for bottom, top in ((0, rows // 2 - 1), (rows // 2, rows - 1))
    ]
    declared = read_toml(_WORLDS, Kind("study", "install it again"))
    for value, given in declared[axis].items():
        if axis == "everything":
            yield value, everything
            continue
        if "sensor" in given:
            given["sensor"] = camera | given["sensor"]
        if mus := given.pop("mu_quarters", ()):
            low, high = mus
            patches = zip(quarters, (low, high, high, low), strict=True)
            given["mu_patches"] = [{"cells": cells, "mu": mu} for cells, mu in patches]
        yield value, validate_argument("world", given, World)
