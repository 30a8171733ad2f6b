"""Measurements of machines, kept in the cache under a hash of what they depend on.

Calibrations, motion primitives, stopping distances and moves are measured once for a machine, its
motors, a world and a clock. What decides nothing is left out, so that they are found again.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from cosim.base.provenance import digest_of
from cosim.base.storage import cache_dir, cached, write_json
from cosim.model.config import CoSimConfig
from cosim.model.params import ESTIMATOR, TIMING
from cosim.model.preset import PAPER
from cosim.model.world import World
from fmus.build import identity_of_fmu

Result = TypeVar("Result")
LOAD = ("restitution", "payload_g", "payload_offset_mm")  # of a world, on a level floor
_CLOCK = ("dt_s", "communication_step_s", "control_period_s")


def reduced(config: CoSimConfig, world: Sequence[str]) -> CoSimConfig:
    """Return a configuration without what decides nothing for robots that are far apart.

    Args:
        world: fields of the world that they meet.
    """
    return replace(
        config,
        timing=TIMING._replace(**{name: getattr(config.timing, name) for name in _CLOCK}),
        world=World(**{name: getattr(config.world, name) for name in world}),
        on_collision="end",
        through=False,
        shield=None,
        preset=PAPER,
        estimator=config.estimator if "sensor" in world else ESTIMATOR,
    )


def key_of(
    what: str,
    version: int,
    config: CoSimConfig,
    motor_fmu: Path,
    *further: Any,
    steering: Sequence[str] | None = None,
) -> str:
    """Hash (16 hex digits) of what a measurement depends on, of which sources are no part.

    Args:
        further: seed, cell and the like.
        steering: fields of the steering that matter, by default all.
    """
    own = vars(config) | {"sources": ()}
    if steering is not None:
        own["steering"] = {name: getattr(config.steering, name) for name in steering}
    return digest_of(what, version, own, identity_of_fmu(motor_fmu), *further)


def measured(
    key: str, kind: type[Result], measure: Callable[[], Result], *, again: bool = False
) -> Result:
    """Return a result from the cache, or measure it and keep it there."""
    return cached(
        cache_dir("calibrations") / f"{key}.json",
        lambda path: msgspec.json.decode(path.read_bytes(), type=kind),
        measure,
        lambda found, path: write_json(path, found),
        again=again,
    )
