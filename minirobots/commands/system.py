"""Simulate any FMUs, coupled as an SSP file says."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from cosim.base.errors import UserError, at_end
from cosim.base.progress import Progress
from minirobots.options import File, IsolatedOptions

if TYPE_CHECKING:
    from cosim.system.run import SystemRun
    from cosim.system.system import System

Seconds = Annotated[float, tyro.conf.arg(metavar="S")]


@dataclass(frozen=True, kw_only=True)
class SimulateSystem(IsolatedOptions):
    """Simulate the FMUs of an SSP file (1.0 or 2.0), coupled by a compiled master.

    FMUs are of FMI 2.0 or 3.0 for Co-Simulation, in one system also both. All outputs are recorded
    at every step.
    """

    file: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
    """The system: an archive (.ssp) or a description (.ssd) next to its FMUs."""
    until: Annotated[float | None, tyro.conf.arg(metavar="S")] = None
    """Simulated time to reach, in s; by default that of the file's default experiment."""
    step: Seconds = 1e-3
    """Communication step in s; with a tolerance the shortest one."""
    algorithm: Literal["jacobi", "gauss-seidel"] = "jacobi"
    """Whether components step with the outputs of the step before, or one after the other, each
    with the newest outputs, in the order of the file."""
    tolerance: Annotated[float | None, tyro.conf.arg(metavar="SHARE")] = None
    """Vary the step so that the error of one in Float64 outputs stays below this share of the
    larger of a value and its nominal one; FMUs must be able to save their states."""
    longest_step: Annotated[float | None, tyro.conf.arg(metavar="S")] = None
    """With a tolerance, the longest step in s."""
    event_mode: bool = False
    """Let FMUs that can (FMI 3.0, hasEventMode) return early and leave their events to the
    master."""
    record: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME ...")] = ()
    """Variables to record, as component.variable; by default all outputs."""
    every: Annotated[int, tyro.conf.arg(metavar="N")] = 1
    """Record every so many steps."""
    profile: bool = False
    """Print time, steps and rollbacks of every FMU."""
    out: File | None = None
    """Where to write what was recorded: .csv or .parquet."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.out is not None and self.out.suffix not in (".csv", ".parquet"):
            raise UserError(f"--out {self.out}: name a .csv or .parquet file")

    @property
    def foreign(self) -> Path:
        """The system, whose FMUs are foreign."""
        return self.file


def run(options: SimulateSystem, progress: Progress) -> "tuple[int, System, SystemRun]":
    """Simulate the system and write what was recorded."""
    from cosim.system.run import write_run
    from cosim.system.ssp import read_system
    from cosim.system.system import System

    found = read_system(options.file)
    until_s = found.stop_s if options.until is None else options.until
    if until_s is None:
        raise UserError(f"{options.file} has no default experiment; pass --until")
    system = System(
        found.components,
        found.connections,
        algorithm=options.algorithm,
        step_s=options.step,
        tolerance=options.tolerance,
        longest_step_s=options.longest_step,
        start_s=found.start_s or 0.0,
        record=options.record or None,
        event_mode=options.event_mode,
        profile=options.profile,
    )
    at_end.append(lambda _: system.close())  # whatever its FMUs do in their end, results are whole
    simulated = system.run(until_s, every=options.every, progress=progress)
    if options.out is not None:
        write_run(options.out, simulated)
    return len(found.components), system, simulated


def show(options: SimulateSystem, simulated: "tuple[int, System, SystemRun]") -> dict[str, Any]:
    """Print the last values, and with --profile what every FMU took."""
    components, system, run = simulated
    last = {name: values[-1].tolist() for name, values in run.signals.items()}
    print(f"{components} components at {system.time_s:g} s, after {system.steps} steps")
    if run.ended:
        print(run.ended)
    for name, value in last.items():
        print(f"  {name} = {value}")
    if options.profile:
        from cosim.base.command import show_table

        rows = [
            [name, str(share.steps), str(share.rollbacks), f"{1e3 * share.time_s:.3f}"]
            for name, share in run.profile.items()
        ]
        show_table(None, ["component", "steps", "rollbacks", "time / ms"], rows, numbers=3)
    if options.out is not None:
        print(f"written to {options.out}")
    return {
        "time_s": system.time_s,
        "steps": system.steps,
        "rejected": system.rejected,
        "ended": run.ended,
        "last": last,
        "profile": {name: share._asdict() for name, share in run.profile.items()},
        "out": None if options.out is None else str(options.out),
    }
