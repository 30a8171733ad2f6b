"""Finished stages of a reproduction, and the time of each: `timings.json`.

Written after every stage and on an interrupt, so that the same command resumes.
"""

import contextlib
import os
import time
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import msgspec

from analysis.profiles import Profile
from cosim.base.errors import UserError
from cosim.base.provenance import digest_of, versions
from cosim.base.reading import Kind, read_json
from cosim.base.storage import write_json

SCHEMA_VERSION = 1
FILE = "timings.json"
# Modules with the `VERSION` of a kind of results: what computes it, or keeps it.
PRODUCERS = (
    "agent.evaluation.cases",
    "agent.mdp.optimum",
    "agent.moves.group",
    "agent.moves.observe",
    "agent.moves.pair",
    "agent.training.learning",
    "cosim.calibration.measuring",
    "cosim.calibration.shielding",
)


class Stage(msgspec.Struct, frozen=True):
    """A stage of a reproduction."""

    seconds: float  # wall-clock time of all attempts
    attempts: int  # their number; those before the last were interrupted
    finished: bool  # whether the last one came to its end
    made_by: str | None = None  # see `made_by`


class TimingsFile(msgspec.Struct, frozen=True):
    """Content of `timings.json`."""

    schema_version: int
    profile: dict[str, Any]  # fields of the `Profile`, which may be that of another version
    seed: int
    cores: int | None
    stages: dict[str, Stage]  # by name, in the order of their first end


def read_timings(results: Path) -> TimingsFile | None:
    """Timings of a results folder; None if `minirobots reproduce` did not make it."""
    path = results / FILE
    kind = Kind("result", "make it again")
    return read_json(path, kind, TimingsFile) if path.exists() else None


def made_by() -> str:
    """Return the hash (16 hex digits) of the versions of this package and of all producers."""
    producers = {name: import_module(name).VERSION for name in PRODUCERS}
    return digest_of(versions()["minirobots"], producers)


class Timings:
    """The stages of one reproduction; a folder with another profile or seed is refused."""

    def __init__(self, results: Path, profile: Profile, seed: int) -> None:
        self._path, found = results / FILE, read_timings(results)
        # As it is read back: JSON knows no tuples.
        asked = msgspec.json.decode(msgspec.json.encode(profile))
        if found is not None and (found.profile, found.seed) != (asked, seed):
            raise UserError(
                f"{results}: has the results of profile {found.profile.get('name')}, seed "
                f"{found.seed}, perhaps of another version; give the options it was started "
                "with or choose another --out"
            )
        self._content = found or TimingsFile(SCHEMA_VERSION, asked, seed, os.cpu_count(), {})

    def finished(self, stage: str) -> bool:
        """Return whether the stage has been completed by the present versions of its producers."""
        found = self._content.stages.get(stage)
        return found is not None and found.finished and found.made_by == made_by()

    @contextlib.contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time the body; what an interrupted attempt took is added to what it took before.

        A stage that is rebuilt is timed again.
        """
        before = self._content.stages.get(name)
        earlier_s, attempts = 0.0, 0
        if before is not None and not before.finished:
            earlier_s, attempts = before.seconds, before.attempts
        began, finished = time.perf_counter(), False
        try:
            yield
            finished = True
        finally:
            seconds = round(earlier_s + time.perf_counter() - began, 3)
            self._content.stages[name] = Stage(seconds, attempts + 1, finished, made_by())
            write_json(self._path, self._content)

    def seconds(self, stage: str) -> float:
        """Wall-clock time of all attempts so far."""
        return self._content.stages[stage].seconds
