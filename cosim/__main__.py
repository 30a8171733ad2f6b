"""Commands that are not yet modules of `minirobots.commands`."""

from typing import NamedTuple


class Command(NamedTuple):
    """A sub-command.

    Attributes:
        module: with `main`, and the options class for shell completion.
        options: name of that class.
        purpose: in a few words.
    """

    module: str
    options: str
    purpose: str


COMMANDS = {
    "falsify": Command(
        "agent.falsification.__main__", "Falsify", "the worst episodes of a policy, searched for"
    ),
    "experiments": Command(
        "agent.experiments.__main__", "Experiments", "the paper's learning experiments"
    ),
}
