"""Identify a robot's parameters from its track by a camera."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import tyro

from cosim.base.command import MotorFmuFile, MotorParameters
from cosim.base.errors import UserError
from cosim.base.progress import Progress
from cosim.model.preset import PAPER
from minirobots.options import Folder, IsolatedOptions, ending


class IdentifyRobot(IsolatedOptions):
    """Identify a robot: friction, centre of mass, feet, motors and camera delay from its track.

    Drive the robot with the motor speeds that --excite writes and record, with an overhead camera,
    a CSV file with the columns time, x, y, heading, omega_1, omega_2 (s, m, rad, rad/s; motors D
    and E). The parameters are those of the best fit, each with an interval of 95 %.
    """

    track: Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="TRACK.csv")] = None
    """The track."""
    excite: Annotated[Path | None, ending(".csv"), tyro.conf.arg(metavar="FILE.csv")] = None
    """Write the motor speeds to drive a robot with: time, omega_1, omega_2."""
    out: Folder = Path("runs/robot")
    """Output folder: preset.toml, identification.json, report.md, tracks.svg."""
    preset: Annotated[str, tyro.conf.arg(metavar="NAME|FILE")] = PAPER
    """Machine that the robot is like: what is not identified, such as its mass, and what is assumed
    before anything is."""
    board: Annotated[tuple[float, float] | None, tyro.conf.arg(metavar="M M")] = None
    """Width and height of the board in m, with its corner at the origin; by default endless."""
    motor_fmu: MotorFmuFile = None
    motor_parameters: MotorParameters = ()
    """Parameter of the motor FMU to set through FMI, in the FMU's unit, such as J=5e-9; repeat it
    for several. By default the FMU's own values hold."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.track is None) == (self.excite is None):
            raise UserError("name a track to identify a robot from, or --excite FILE.csv")


def run(options: IdentifyRobot, progress: Progress) -> Iterator[Any]:
    """Identify the robot and print its parameters; or write the motor speeds to drive it with."""
    if options.track is None:
        from cosim.machine.identification.track import HOLD_S, SEQUENCE, write_excitation

        assert options.excite is not None
        write_excitation(options.excite)
        duration_s = len(SEQUENCE) * HOLD_S
        yield {"excitation": str(options.excite), "duration_s": duration_s}
        print(f"motor speeds for {duration_s:g} s in {options.excite}")
        return
    from cosim.base.table import show
    from cosim.machine.identification.result import COLUMNS, identify
    from cosim.machine.identification.track import read_track
    from cosim.model.preset import find_preset
    from cosim.simulation.options import Physics

    track, preset = read_track(options.track, options.board), find_preset(options.preset)
    physics = Physics(
        preset=options.preset,
        motor_fmu=options.motor_fmu,
        motor_parameters=options.motor_parameters,
    )
    fmu, config, name = physics.fmu(progress), physics.config(), options.track.name
    report = identify(track, name, preset, config, fmu, options.out, progress)
    yield report
    show(COLUMNS, report.parameters, names=2)
    for words in report.unidentifiable:
        print(f"not identifiable from this track: {words}")
    print(f"results in {options.out}/: preset.toml, identification.json, report.md, tracks.svg")
