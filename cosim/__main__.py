"""`minirobots`: all commands under one name, each loaded when it is asked for."""

import sys
from importlib import import_module
from typing import NamedTuple

from cosim.base.errors import USER_ERROR_STATUS, end_at_interrupt, run_command


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
    "evaluate-grid": Command("agent.evaluate", "EvaluateOnGrid", "the same on the grid, exactly"),
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
    "moves": Command("agent.moves.__main__", "ObserveMoves", "observe what moves really do"),
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
    "inspect": Command("analysis.inspect", "Inspect", "what a recording holds, what looks wrong"),
    "browse": Command("analysis.browse.__main__", "Browse", "the episodes of a run as a table"),
    "export": Command("analysis.export.__main__", "Export", "a recording for other programs"),
    "screenshot": Command("analysis.screenshot", "Screenshot", "what the viewer shows, as a file"),
}
_COMPLETION = "--tyro-print-completion"


def main() -> None:
    """Hand over to a sub-command, or say which there are."""
    end_at_interrupt()
    name, *rest = sys.argv[1:] or ["--help"]
    if name in {"-h", "--help"}:
        print("usage: minirobots COMMAND [OPTIONS]   (minirobots COMMAND --help tells them)\n")
        for known, command in COMMANDS.items():
            print(f"  {known:<15}{command.purpose}")
        print(f"\nshell completion: minirobots {_COMPLETION} bash, zsh or tcsh")
        return
    if name.startswith(_COMPLETION):
        _print_completion(sys.argv[1:])
        return
    if name not in COMMANDS:
        print(
            f"error: minirobots has no command {name}; choose one of {', '.join(COMMANDS)}",
            file=sys.stderr,
        )
        sys.exit(USER_ERROR_STATUS)
    sys.argv = [f"minirobots {name}", *rest]
    run_command(import_module(COMMANDS[name].module).main)


def _print_completion(arguments: list[str]) -> None:
    """What a shell completes, of all commands at once."""
    from tyro.extras import SubcommandApp

    app = SubcommandApp()
    for name, command in COMMANDS.items():
        app.command(getattr(import_module(command.module), command.options), name=name)
    app.cli(prog="minirobots", args=arguments)


if __name__ == "__main__":
    main()
