"""What a reproduction has finished, and how long each stage took: `timings.json`.

Written after every stage and on an interrupt, so that the same command goes on where it ended.
"""

import contextlib
import json
import os
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

from analysis.profiles import Profile
from analysis.reading.results import RESULTS
from analysis.report.tables import TIMINGS_FILE, TimingsContent, read_timings
from cosim.base.errors import UserError
from cosim.base.provenance import ROOT, code_digest, with_imports
from cosim.base.storage import replacing

SCHEMA_VERSION = 1


class TimingsError(UserError):
    """A results folder of another reproduction."""


def code_of(stage: str) -> str | None:
    """Hash (16 hex digits) of the code that makes a result; None if the stage is of no result."""
    if stage not in RESULTS:
        return None
    place = ROOT.joinpath(*RESULTS[stage].module.split("."))
    command = place / "__main__.py" if place.is_dir() else place.with_suffix(".py")
    return code_digest(with_imports([command]))


class Timings:
    """The stages of one reproduction.

    Args:
        results: its results folder.
        profile: what it does.
        seed: of everything random in it.

    Raises:
        TimingsError: the folder has the results of another profile or seed.
        ReportError: its file is damaged.
    """

    def __init__(self, results: Path, profile: Profile, seed: int) -> None:
        self._path = results / TIMINGS_FILE
        # As it is read back: JSON knows no tuples.
        identity: dict[str, Any] = json.loads(
            json.dumps({"profile": asdict(profile), "seed": seed})
        )
        found = read_timings(results)
        if found is not None and {name: found[name] for name in identity} != identity:
            raise TimingsError(
                f"{results}: has the results of profile {found['profile'].get('name')}, seed "
                f"{found['seed']}, perhaps of another version; give the options it was started "
                "with or choose another --out"
            )
        self._content: TimingsContent = found or {
            "schema_version": SCHEMA_VERSION,
            "profile": identity["profile"],
            "seed": seed,
            "cores": os.cpu_count(),
            "stages": {},
        }

    def finished(self, stage: str) -> bool:
        """Whether the stage has been completed, by code that does what it does now."""
        entry = self._content["stages"].get(stage, {})
        return entry.get("finished", False) and entry.get("code") == code_of(stage)

    @contextlib.contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time the body; what an interrupted attempt took is added to what it took before.

        A stage that is finished and made again is timed anew.
        """
        stages = self._content["stages"]
        before = stages.get(name, {})
        anew = before.get("finished", True)
        earlier_s, attempts = (0.0, 0) if anew else (before["seconds"], before["attempts"])
        code = code_of(name)
        began, finished = time.perf_counter(), False
        try:
            yield
            finished = True
        finally:
            stages[name] = {
                "seconds": round(earlier_s + time.perf_counter() - began, 3),
                "attempts": attempts + 1,
                "finished": finished,
                "code": code,
            }
            self._write()

    def seconds(self, stage: str) -> float:
        """Wall-clock time of all attempts so far."""
        return self._content["stages"][stage]["seconds"]

    def _write(self) -> None:
        with replacing(self._path) as temporary:
            temporary.write_text(json.dumps(self._content, indent=1) + "\n", encoding="utf-8")
