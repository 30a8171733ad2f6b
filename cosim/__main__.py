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
    "run": Command("cosim.run", "Run", "train, co-simulate and record episodes"),
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
    "calibrate": Command("cosim.calibrate", "Calibrate", "motor speeds to speed and yaw rate"),
    "identify-robot": Command(
        "cosim.identification.__main__", "IdentifyRobot", "a robot's parameters from its track"
    ),
    "platform": Command(
        "cosim.platform.__main__", "MovePlatform", "the 1-DOF platform of Eq. (1), Fig. 3"
    ),
    "design": Command("cosim.design", "DesignRobot", "what gives a robot a wanted speed"),
    "validate": Command(
        "cosim.validation.__main__", "Validate", "ours beside published numbers of machines"
    ),
    "system": Command(
        "cosim.system.__main__", "SimulateSystem", "any FMUs, coupled as an SSP file says"
    ),
    "fmu": Command("fmus.build", "Build", "motors and robots as FMUs and SSP for other tools"),
    "firmware": Command(
        "agent.firmware.__main__", "Firmware", "a policy and its steering for a microcontroller"
    ),
    "figures": Command("analysis.figures.__main__", "Figures", "draw the paper's figures"),
    "reproduce": Command("analysis.reproduce", "Reproduce", "the whole paper in one command"),
    "report": Command("analysis.report.__main__", "Report", "one page with all results"),
    "serve": Command("analysis.serve", "Serve", "open a report in the browser"),
    "replay": Command("cosim.replay", "Replay", "run a recorded episode again, compare every bit"),
    "browse": Command("analysis.browse.__main__", "Browse", "the episodes of a run as a table"),
    "export": Command("analysis.export.__main__", "Export", "a recording for other programs"),
    "screenshot": Command("analysis.screenshot", "Screenshot", "what the viewer shows, as a file"),
}
