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
    "evaluate": Command("cosim.evaluate", "Evaluate", "what policies achieve in the dynamics"),
    "transfer": Command("cosim.transfer", "Transfer", "success in the dynamics by method"),
    "robustness": Command("cosim.robustness", "Robustness", "success in worlds not ideal"),
    "certify": Command(
        "agent.certification.__main__", "Certify", "a claim about a policy, with its confidence"
    ),
    "falsify": Command(
        "agent.falsification.__main__", "Falsify", "the worst episodes of a policy, searched for"
    ),
    "experiments": Command(
        "agent.experiments.__main__", "Experiments", "the paper's learning experiments"
    ),
    "baselines": Command(
        "agent.baselines.__main__", "Baselines", "what learners achieve, and at what price"
    ),
    "validate": Command(
        "cosim.validation.__main__", "Validate", "ours beside published numbers of machines"
    ),
}
