"""The methods that make policies, and when to use which."""

from collections.abc import Iterator
from typing import Any

from cosim.base.progress import Progress
from minirobots.options import CommandOptions


class Methods(CommandOptions):
    """Print the methods that make policies: how, for how many robots, and when to use them.

    They are the values of --method of `minirobots run`. docs/methods.md compares what they achieve.
    """


def run(options: Methods, _: Progress) -> Iterator[Any]:
    """Print a row for each method."""
    from agent.training.methods import METHODS
    from cosim.base.table import show_texts

    rows = [{"method": name, **method.facts} for name, method in METHODS.items()]
    yield {"methods": rows}
    show_texts(tuple(rows[0]), [tuple(row.values()) for row in rows])
