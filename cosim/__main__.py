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
    "train": Command("agent.experiments.training", "Train", "train many runs and evaluate them"),
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
    "deep": Command("agent.deep.__main__", "Deep", "train one network for all robots"),
    "baselines": Command(
        "agent.baselines.__main__", "Baselines", "what learners achieve, and at what price"
    ),
    "validate": Command(
        "cosim.validation.__main__", "Validate", "ours beside published numbers of machines"
    ),
    "fmu": Command("fmus.build", "Build", "motors and robots as FMUs and SSP for other tools"),
    "figures": Command("analysis.figures.__main__", "Figures", "draw the paper's figures"),
    "report": Command("analysis.report.__main__", "Report", "one page with all results"),
    "serve": Command("analysis.serve", "Serve", "open a report in the browser"),
    "browse": Command("analysis.browse.__main__", "Browse", "the episodes of a run as a table"),
    "export": Command("analysis.export.__main__", "Export", "a recording for other programs"),
    "screenshot": Command("analysis.screenshot", "Screenshot", "what the viewer shows, as a file"),
}
