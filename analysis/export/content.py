"""What every format has of an episode, and the formats by what their files' names end in."""

from typing import TYPE_CHECKING, Any, Literal

from cosim.base.errors import UserError

if TYPE_CHECKING:
    from cosim.reading.episode import Episode
    from cosim.reading.rrd import Signal

Format = Literal["parquet", "csv", "mcap", "mat"]


class ExportError(UserError):
    """A format that cannot be written here; the message says what is missing."""


def facts_of(episode: "Episode") -> dict[str, Any]:
    """What was run, how it ended, and every parameter, as JSON has it."""
    return {
        "facts": dict(episode.facts),
        "outcome": episode.outcome,
        "complete": episode.complete,
        "parameters": {name: p._asdict() for name, p in episode.parameters.items()},
    }


def components_of(signal: "Signal") -> tuple[str, ...]:
    """Names of a signal's components: those of the recording, or their numbers."""
    count = 1 if signal.values.ndim == 1 else signal.values.shape[1]
    return signal.components if len(signal.components) == count else tuple(map(str, range(count)))
