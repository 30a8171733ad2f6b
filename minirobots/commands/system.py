"""Simulate any FMUs, coupled by an SSP file."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from cosim.base.command import NamedNumber
from cosim.base.errors import UserError, at_end
from cosim.base.progress import Progress
from cosim.fmi.archive import MAX_DESCRIPTION_BYTES
from minirobots.options import Count, File, IsolatedOptions, Seconds

if TYPE_CHECKING:
    from cosim.system.result import SystemRun


class SimulateSystem(IsolatedOptions):
    """Simulate the FMUs of an SSP file (1.0 or 2.0), coupled by a compiled master.

    FMUs are of FMI 2.0 or 3.0, for Co-Simulation or for Model Exchange, also mixed. All outputs are
    recorded at every step.
    """

    file: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
    """The system: an archive (.ssp) or a description (.ssd) next to its FMUs."""
    variant: Annotated[str, tyro.conf.arg(metavar="NAME.ssd")] = "SystemStructure.ssd"
    """Description in an archive to simulate, if it has several."""
    until: Seconds | None = None
    """Simulated time to reach, in s; by default that of the file's default experiment."""
    step: Seconds = 1e-3
    """Communication step in s; with a tolerance the shortest one."""
    component_step: Annotated[tuple[NamedNumber, ...], tyro.conf.UseAppendAction] = ()
    """Communication step in s of one component, as in motor=1e-4; repeat for others. All steps are
    whole multiples of the shortest one; rows are recorded at multiples of --step."""
    algorithm: Literal["jacobi", "gauss-seidel", "extrapolated", "implicit"] = "jacobi"
    """Inputs during a step. jacobi: outputs before it. gauss-seidel: the newest outputs, as
    components step one after the other in the order of the file. Two are of second order:
    extrapolated (means over the step, continued from the step before) and implicit (the same, but
    steps are rolled back and repeated until outputs agree; for stiff couplings; FMUs must be able
    to save their states)."""
    loops: Literal["solve", "explicit"] = "solve"
    """Whether algebraic loops are solved at every communication point, or a delay of one step is
    accepted in them."""
    input: File | None = None
    """Inputs over time: a .csv or .parquet file with a column time (in s) and columns named
    component.variable or as an input of the system, with a unit if it is another one, as in
    "motor.u [mV]". Between times floats are interpolated, others stay constant."""
    tolerance: Annotated[float | None, tyro.conf.arg(metavar="SHARE")] = None
    """Vary the step so that the error of one in Float64 outputs stays below this share of the
    larger of a value and its nominal one; FMUs must be able to save their states."""
    power_bond: Annotated[
        tuple[str, ...], tyro.conf.arg(metavar="EFFORT=FLOW"), tyro.conf.UseAppendAction
    ] = ()
    """Power bond: the two inputs component.variable that take the effort (a force, a voltage) and
    the flow (a speed, a current) of two connections back and forth; repeat for others. The energy
    that the coupling adds is recorded and printed."""
    step_control: Literal["error", "energy"] = "error"
    """Quantity that the tolerance bounds: error of outputs, or residual power of power bonds as a
    share of the power that passes (energy: no step is repeated, so FMUs need not save their
    states)."""
    solver_tolerance: Annotated[float, tyro.conf.arg(metavar="SHARE")] = 1e-8
    """Relative tolerance of the solver (CVODE) that integrates FMUs for Model Exchange. If an FMU
    has both interfaces, Co-Simulation is used unless the file has implementation="ModelExchange" at
    its component."""
    longest_step: Seconds | None = None
    """With a tolerance, the longest step in s."""
    event_mode: bool = False
    """Let FMUs that can (FMI 3.0, hasEventMode) return early and leave their events to the
    master."""
    record: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME ...")] = ()
    """Variables to record, as component.variable; by default all outputs."""
    every: Annotated[int, tyro.conf.arg(metavar="N")] = 1
    """Record every N-th step."""
    profile: bool = False
    """Print time, steps and rollbacks of every FMU."""
    fmu_log: Literal["off", "warnings", "all"] = "warnings"
    """Messages of the FMUs to show: none (FMUs report none, which is faster), the number of steps
    with a warning and the last warning of each, or all."""
    lenient: bool = False
    """Accept FMUs with a modelDescription.xml that violates the standard. By default only
    violations that change no result are accepted; a warning names each FMU."""
    max_description: Annotated[Count, tyro.conf.arg(metavar="MIB")] = MAX_DESCRIPTION_BYTES >> 20
    """Largest modelDescription.xml in MiB; parsed, it takes some thirty times as much memory."""
    out: File | None = None
    """File of the recorded variables: .csv, .parquet, or .rrd for the Rerun viewer."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.out is not None and self.out.suffix not in (".csv", ".parquet", ".rrd"):
            raise UserError(f"--out {self.out}: name a .csv, .parquet or .rrd file")

    @property
    def foreign(self) -> Path:
        """The system of foreign FMUs."""
        return self.file


def run(options: SimulateSystem, progress: Progress) -> Iterator[Any]:
    """Simulate the system, write the recorded rows, and print the last values.

    With --profile also what every FMU took.
    """
    from cosim.base.arguments import named_once
    from cosim.base.table import show_texts
    from cosim.system.graph import load_fmus
    from cosim.system.inputs import read_inputs
    from cosim.system.result import write_run
    from cosim.system.ssp.reader import read_system
    from cosim.system.system import System

    most_bytes = options.max_description << 20
    found = read_system(
        options.file, lenient=options.lenient, most_bytes=most_bytes, variant=options.variant
    )
    until_s = found.stop_s if options.until is None else options.until
    if until_s is None:
        raise UserError(f"{options.file} has no default experiment; pass --until")
    inputs = None
    if options.input is not None:
        fmus = load_fmus(found.components)
        inputs = read_inputs(options.input, fmus, found.entries, found.units)
    system = System(
        found.components,
        found.connections,
        algorithm=options.algorithm,
        step_s=options.step,
        tolerance=options.tolerance,
        longest_step_s=options.longest_step,
        start_s=found.start_s or 0.0,
        stop_s=until_s,
        record=options.record or None,
        event_mode=options.event_mode,
        profile=options.profile,
        loops=options.loops,
        inputs=inputs,
        fmu_log=options.fmu_log,
        solver_tolerance=options.solver_tolerance,
        component_steps=named_once("component_step", options.component_step),
        power_bonds=[bond.split("=", 1) for bond in options.power_bond],
        step_control=options.step_control,
    )
    at_end.append(lambda _: system.close())  # whatever its FMUs do in their end, results are whole
    run = system.run(until_s, every=options.every, progress=progress)
    if options.out is not None:
        (_write_recording if options.out.suffix == ".rrd" else write_run)(options.out, run)
    last = {name: values[-1].tolist() for name, values in run.signals.items()}
    yield {
        "time_s": system.time_s,
        "steps": system.steps,
        "rejected": system.rejected,
        "ended": run.ended,
        "last": last,
        "profile": {name: share._asdict() for name, share in run.profile.items()},
        "out": None if options.out is None else str(options.out),
    }
    print(f"{len(found.components)} components at {system.time_s:g} s, after {system.steps} steps")
    if run.ended:
        print(run.ended)
    for name, value in last.items():
        print(f"  {name} = {value}")
    if options.profile:
        rows = [
            [name, str(share.steps), str(share.rollbacks), f"{1e3 * share.time_s:.3f}"]
            for name, share in run.profile.items()
        ]
        show_texts(["component", "steps", "rollbacks", "time / ms"], rows, numbers=3)
    if options.out is not None:
        print(f"written to {options.out}")


def _write_recording(path: Path, run: "SystemRun") -> None:
    """Write recorded rows for the Rerun viewer: an entity "component/variable" per signal."""
    import rerun as rr
    import rerun.blueprint as rrb

    from cosim.recording.file import Recording, scalars, simulated

    views = [
        rrb.TimeSeriesView(name=name, origin=rr.new_entity_path([name])) for name in run.profile
    ]
    with Recording(path, "system", rrb.Blueprint(rrb.Tabs(*views))) as recording:
        for name, values in run.signals.items():
            component = max((c for c in run.profile if name.startswith(f"{c}.")), key=len)
            entity = rr.new_entity_path([component, name.removeprefix(f"{component}.")])
            flat = values if values.ndim == 1 else values.reshape(len(values), -1)
            text = values.dtype.kind == "U"
            rows = rr.TextLog.columns(text=values.tolist()) if text else scalars(flat)
            recording.columns(entity, simulated(run.time_s), rows)
