"""Contents of an export in every format, and the formats by what their files' names end in."""

from collections.abc import Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from cosim.base.errors import UserError

if TYPE_CHECKING:
    from cosim.recording.reader import Episode

Format = Literal["parquet", "csv", "mcap", "mat"]


class ExportError(UserError):
    """Unsupported format or empty selection. The message names the reason."""


def chosen(
    episode: "Episode", names: Sequence[str] = (), rate_hz: float | None = None
) -> "Episode":
    """Return an episode with some of its signals and states.

    Args:
        episode: with all of them.
        names: of signals and states, perhaps without the first part of their path, or patterns with
            `*` and `?`; none for all.
        rate_hz: samples of each signal per second: the first one of every period, as it is; all by
            default. States stay.

    Raises:
        ExportError: the rate is not positive, or the recording has nothing of a name.
    """
    from cosim.recording.reader import PREFIXES, Signals

    if rate_hz is not None and not 0.0 < rate_hz < 1e9:
        raise ExportError(f"--rate {rate_hz:g} is invalid; give samples per second above 0")
    paths = [*episode.signals, *episode.texts]
    kept = set() if names else {*paths}
    for name in names:
        found = {path for path in paths if any(fnmatchcase(path, p + name) for p in PREFIXES)}
        if not found:
            raise ExportError(
                f"--signals {name}: {episode.origin} has no such signal or state; "
                "`minirobots inspect` lists them"
            )
        kept |= found
    signals = {path: signal for path, signal in episode.signals.items() if path in kept}
    if rate_hz is not None:
        for path, signal in signals.items():
            _, rows = np.unique(np.floor(signal.time_s * rate_hz + 1e-6), return_index=True)
            signals[path] = signal._replace(time_s=signal.time_s[rows], values=signal.values[rows])
    texts = {path: text for path, text in episode.texts.items() if path in kept}
    return replace(episode, signals=Signals(episode.origin, signals), texts=texts)


def facts_of(episode: "Episode") -> dict[str, Any]:
    """Return the run, its outcome and every parameter, as JSON has it."""
    return {
        "facts": dict(episode.facts),
        "outcome": episode.outcome,
        "complete": episode.complete,
        "parameters": {name: p._asdict() for name, p in episode.parameters.items()},
    }
