"""The commands of `minirobots`: classes of options that can run, see `minirobots.runner.Command`.

Their modules import only what options need, and functions the rest, so that every `--help` comes at
once.
"""

from importlib import import_module
from typing import Any

COMMANDS = {  # module, class and purpose of every command
    "bound": ("policies", "Bound", "The least path length and number of moves of any policy"),
    "calibrate": ("motors", "Calibrate", "Map motor speeds to speed and yaw rate, with a plot"),
    "compare": ("recordings", "Compare", "Show where two episodes part, and what differs"),
    "design": ("motors", "DesignRobot", "Find designs with a desired speed, all feet on the floor"),
    "draw": ("motors", "DrawMachines", "Draw machines from above and from the side"),
    "evaluate": ("policies", "Evaluate", "Evaluate policies in the full dynamics, or on the grid"),
    "experiments": ("policies", "Experiments", "The paper's learning experiments"),
    "export": ("recordings", "Export", "Write a recording for other programs"),
    "figures": ("paper", "Figures", "Draw the paper's figures from a folder of results"),
    "fmu": ("motors", "BuildFmus", "Build motors as FMUs for other tools, or from sources"),
    "identify-robot": ("motors", "IdentifyRobot", "Identify a robot's parameters from its track"),
    "inspect": ("recordings", "Inspect", "Show what a recording contains, and looks wrong"),
    "methods": ("policies", "Methods", "The methods that make policies, and when to use which"),
    "motor-loop": ("motors", "MotorLoop", "Draw the motor's speed loop, and propose gains for it"),
    "motor-test": ("motors", "MotorTest", "Record the test of Fig. 7, a motor in both loops"),
    "moves": ("policies", "ObserveMoves", "Observe what moves really do"),
    "platform": ("motors", "MovePlatform", "Move the 1-DOF platform of Eq. (1): data of Fig. 3"),
    "replay": ("episodes", "Replay", "Run a recorded episode again and compare every bit"),
    "reproduce": ("paper", "Reproduce", "Reproduce the paper: results, figures and the report"),
    "run": ("episodes", "Run", "Train, co-simulate and record episodes"),
    "screenshot": ("recordings", "Screenshot", "Save the Rerun viewer's picture of a recording"),
    "study": ("policies", "Study", "A study of your own: policies, scenarios, worlds, options"),
    "train": ("policies", "Train", "Train many runs of one configuration and evaluate them"),
    "video": ("recordings", "Video", "Make a video of an episode: the board from above"),
    "web": ("episodes", "Web", "Write a page in which the robots drive in any browser"),
}


def class_of(name: str) -> Any:
    """Return the class of a command."""
    module, kind, _ = COMMANDS[name]
    return getattr(import_module(f"minirobots.commands.{module}"), kind)
