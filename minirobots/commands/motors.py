"""Commands about motors, machines and FMUs."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from msgspec import Meta

from analysis.motor.loop_options import StepTest
from cosim.base import command as opt
from cosim.base.arguments import validate_unique
from cosim.base.errors import UserError
from cosim.base.progress import Progress
from cosim.base.storage import PICTURE, require_suffix, write_json
from cosim.base.table import show, show_texts
from cosim.model.preset import PAPER, find_preset
from cosim.simulation.options import Physics
from fmus.compiler import TARGETS, host_target
from fmus.models import MODELS, STANDARDS, Fmi, Model
from minirobots.runner import Command, Output

if TYPE_CHECKING:
    from cosim.machine.platform.design import Design
    from cosim.model.params import RobotParams

    TargetChoice = str
else:
    TargetChoice = tyro.extras.literal_type_from_choices(("host", "all", *TARGETS))
What = Literal["motor", "motors"]
SHORT_NAMES: dict[What, Model] = {"motor": "VibrationMotor", "motors": "VibrationMotors"}


@dataclass(frozen=True, kw_only=True)
class MotorTest(Command):
    """Record the step responses of Fig. 7: one motor in open loop, and one in closed loop.

    From one third of the time on a disturbance torque drives the shaft, from two thirds on it
    brakes it: the open loop settles elsewhere, the closed loop returns to its set point.
    """

    out: opt.File = Path("runs/motor_test.rrd")
    """Recording to write (.rrd)."""
    motor_fmu: opt.MotorFmuFile = None
    test: Annotated[StepTest, tyro.conf.OmitArgPrefixes] = field(default_factory=StepTest)

    def run(self, progress: Progress) -> Output:
        from analysis.figures.fig07 import EARLY_S, drawing_of
        from analysis.motor.step_test import record
        from analysis.reading.motor_test import read
        from fmus.build import cached_fmu

        fmu = self.motor_fmu or cached_fmu("VibrationMotor")
        out = require_suffix(self.out, ".rrd")
        record(out, fmu, self.test)
        if self.test.duration < EARLY_S:  # too short for the times of Fig. 7
            return Output({"out": str(out)}, f"recording: {out}")
        drawing = drawing_of(*read(out))
        return Output({"out": str(out)} | drawing.numbers, *drawing.ours, f"recording: {out}")


@dataclass(frozen=True, kw_only=True)
class MotorLoop(Command):
    """Draw the motor's speed loop, print its poles, bandwidth and margins, and propose gains.

    python-control computes them from the transfer functions; the FMU's own frequency response,
    measured without Coulomb friction and weight, is drawn with them. The proposed gains cancel the
    motor's pole (K_i = K_p/τ); K_p is as large as the voltage of a step from rest and a phase
    margin of 60° with a delay of 1 ms allow. A table compares how the FMU's speed comes up to the
    set point with its own and other gains, and without anti-windup.
    """

    out: opt.File = Path("figures/motor_loop.png")
    """Figure to write; PNG and PDF are written next to each other."""
    motor_fmu: opt.MotorFmuFile = None
    motor_parameters: opt.MotorParameters = ()
    omega_des: Annotated[opt.Positive | None, tyro.conf.arg(metavar="RAD_S")] = None
    """Set point of the step in rad/s, for which the gains are proposed; by default 700, or 80 % of
    what the motor reaches, if that is less."""

    def run(self, progress: Progress) -> Output:
        import numpy as np

        from analysis.figures.style import NOTHING, save
        from analysis.motor import speed_loop as theory
        from analysis.motor.instance import GivenMotor
        from analysis.motor.steps import compare_gains, draw
        from cosim.fmi.motor import MotorFmu
        from cosim.model.params import motor_time_constant
        from fmus.build import cached_fmu

        fmu = MotorFmu(self.motor_fmu or cached_fmu("VibrationMotor"))
        at_hand = GivenMotor.of(fmu, validate_unique("motor_parameters", self.motor_parameters))
        motor = at_hand.params
        omega_des = theory.step_speed(motor, self.omega_des)
        proposed, limit = theory.propose(motor, omega_des)
        loop = theory.speed_loop(motor)
        frequencies = theory.frequencies_of(loop)
        measured = theory.measured_response(at_hand, frequencies, progress)
        steps = compare_gains(at_hand, proposed, omega_des, progress)
        merits = [theory.figures_of_merit(each) for each in (loop, theory.speed_loop(proposed))]
        figure = draw(motor, proposed, frequencies, measured, steps, omega_des)
        files = [str(path) for path in save(figure, self.out)]
        pole = -1.0 / motor_time_constant(motor)
        gains = {"K_p": proposed.K_p, "K_i": proposed.K_i, "limited_by": limit}
        result = merits[0].record() | {
            "motor_pole_rad_s": pole,
            "motor": motor._asdict(),
            "proposed": gains | merits[1].record(),
            "frequency_rad_s": frequencies.tolist(),
            "fmu_magnitude": np.abs(measured).tolist(),
            "fmu_phase_rad": np.angle(measured).tolist(),
            "omega_des": omega_des,
            "gains": [step.record() for step in steps],
            "files": files,
        }
        header = ("K_p", "K_i", "anti-windup", "63 %", "90 %", "98 %", "within ±2 %", "overshoot")
        rows = [
            (
                f"{step.K_p:.3g}",
                f"{step.K_i:.3g}",
                "FMU's" if step.anti_windup else "no",
                *(NOTHING if time_s is None else f"{time_s:.3f} s" for time_s in step.rise[:-1]),
                f"{100.0 * max(step.rise[-1], 0.0):.1f} %",
            )
            for step in steps
        ]
        return Output(
            result,
            f"motor alone: pole {pole:.4g} rad/s",
            f"closed loop, {_merits(motor, merits[0])}",
            f"proposed, limited by the {limit}, {_merits(proposed, merits[1])}",
            lambda: show_texts(header, rows, title=f"step to {omega_des:g} rad/s"),
            f"figure: {', '.join(files)}",
        )


def _merits(motor: Any, merit: Any) -> str:
    """Return gains, poles, bandwidth and margins as text."""
    poles = ", ".join(
        f"{p.real:.4g} ± {p.imag:.4g}j" if p.imag else f"{p.real:.4g}"
        for p in merit.poles_rad_s
        if p.imag >= 0.0
    )
    phase = "infinite"
    if merit.crossover_rad_s > 0.0:
        late = f"{merit.delayed_phase_margin_deg:.1f}° with a delay of 1 ms"
        phase = f"{merit.phase_margin_deg:.1f}° at {merit.crossover_rad_s:.4g} rad/s, {late}"
    return (
        f"K_p = {motor.K_p:.4g} V s/rad, K_i = {motor.K_i:.4g} V/rad: poles {poles} rad/s, "
        f"bandwidth {merit.bandwidth_rad_s:.4g} rad/s, gain margin {merit.gain_margin:g}, "
        f"phase margin {phase}"
    )


@dataclass(frozen=True, kw_only=True)
class Calibrate(Command):
    """Calibrate the drive: measure the speed and yaw rate that motor speeds give.

    Of a machine whose file does not say how its motors drive and turn it, the motion primitives are
    found first: set points, from random ones, with their repeatability, and a drawing of where they
    take it. Then single robots are co-simulated with their motor FMUs and noise in every primitive,
    over motor speeds, speed differences and phases between the motors: the map, its scatter and a
    plot. The co-simulation calibrates itself likewise when robot, motors, FMU, clock or noise
    change; this command shows the result.
    """

    out: opt.Folder = Path("runs/calibration")
    """Output folder: calibration.npz, .json and .png, and primitives.json and .png if they are
    found."""
    again: bool = False
    """Measure even if the cache has this calibration."""
    jobs: opt.Jobs = -1
    physics: Annotated[Physics, tyro.conf.OmitArgPrefixes] = field(default_factory=Physics)

    def run(self, progress: Progress) -> Output:
        from analysis.figures.machine import draw_primitives
        from cosim.base.plotting import save_figure
        from cosim.calibration.measuring import find_calibration
        from cosim.calibration.primitives import find_primitives, primitive_rows, steered
        from cosim.calibration.report import draw, report_of, speed_rows
        from cosim.fmi.motor import with_motor

        config, jobs, out = self.physics.config(), opt.workers(self.jobs), self.out
        out.mkdir(parents=True, exist_ok=True)
        fmu = self.physics.fmu(progress)
        config = with_motor(config, fmu)
        texts: list[Any] = []
        if not config.steering.given:
            primitives = find_primitives(config, fmu, progress, again=self.again)
            write_json(out / "primitives.json", primitives)
            save_figure(draw_primitives(primitives, config.robot), out / "primitives.png", dpi=150)
            header = ("primitive", "ahead, mm/s", "aside, mm/s", "yaw, °/s", "in the air", "rad/s")
            rows = primitive_rows(primitives, config)
            config = steered(config, primitives)
            steering = config.steering
            texts = [
                lambda: show_texts(header, rows),
                f"steered at {1e3 * steering.drive_speed_m_s:.2f} mm/s and "
                f"{math.degrees(steering.turn_rate_rad_s):.1f} °/s",
                f"results in {out}/: primitives.json, .png",
            ]
        calibration = find_calibration(config, fmu, progress, jobs=jobs, again=self.again)
        report = report_of(calibration, config, fmu)
        calibration.save(out / "calibration.npz")
        write_json(out / "calibration.json", report)
        noise = config.noise.relative_amplitude
        title = f"{config.preset}, μ = {config.robot.mu:g}, noise ±{noise:.0%}"
        picture = draw(calibration, title, config.steering.forward_speed_rad_s)
        save_figure(picture, out / "calibration.png", dpi=150)
        heads = ("primitive", "motor speed", "mean", "scatter", "airborne")
        return Output(
            report,
            *texts,
            lambda: show_texts(heads, speed_rows(calibration)),
            f"without hopping: motors up to {report.hop_free_rad_s:.0f} rad/s, "
            f"{1e3 * report.largest_speed_m_s:.2f} mm/s ahead and back, "
            f"{math.degrees(report.largest_turn_rate_rad_s):.1f} °/s in both turns",
            f"results in {out}/: calibration.npz, .json, .png",
        )


@dataclass(frozen=True, kw_only=True)
class DrawMachines(Command):
    """Draw machines from above and from the right, to scale: body, motors, shafts, feet, mass.

    A motor's square is its eccentric mass, behind which its body lies. Seen from the tip of the
    shaft, a motor with a positive speed turns counter-clockwise.
    """

    machines: Annotated[
        tuple[str, ...],
        tyro.conf.Positional,
        tyro.conf.arg(metavar="NAME|FILE …", help=f"Machines: {opt.MACHINES}."),
    ] = (PAPER,)
    out: opt.File = Path("machines.png")
    """Picture to write (.png, .pdf or .svg)."""

    def run(self, progress: Progress) -> Output:
        from analysis.figures.machine import draw_machines
        from cosim.base.plotting import save_figure

        out = require_suffix(self.out, *PICTURE)
        presets = map(find_preset, self.machines)
        machines = {preset.name: preset.config().robot for preset in presets}
        save_figure(draw_machines(machines), out, dpi=100)
        return Output({"picture": str(out)})


@dataclass(frozen=True, kw_only=True)
class MovePlatform(Command):
    """Move the 1-DOF platform of Eq. (1) and write its motion: the data of Fig. 3.

    Two platforms: one that looks like the printed figure, and the robot of Tables I and II, or of
    another machine. The result file also holds a table of net speeds over friction and motor speed.
    """

    out: opt.File = Path("runs/platform.npz")
    """Result file (.npz)."""
    cycles: Annotated[int, Meta(ge=1, le=100)] = 6
    """Turns of the motor to show."""
    omega: Annotated[float, tyro.conf.arg(metavar="RAD_S")] = 900.0
    """Motor speed of the platform of Tables I and II, in rad/s."""
    preset: opt.PresetName = PAPER
    mu: opt.Friction = None

    def run(self, progress: Progress) -> Output:
        from cosim.machine.platform.motion import move_platforms

        out = require_suffix(self.out, ".npz")
        config = find_preset(self.preset).config().having("given", mu=self.mu)
        result = move_platforms(self.cycles, self.omega, config.robot, config.motor)
        result.save(out)
        table, motions = result.table, {"fig_3": result.fig_3, "table_ii": result.table_ii}
        own = "Tables I and II" if self.preset == PAPER else f"machine {Path(self.preset).stem}"
        texts = "assumed platform, resembling the printed Fig. 3", own
        names = ("mu", "omega_rad_s", "net_speed_m_s")
        steps = {f"{n}_net_displacement_m": float(m.net_displacement_m) for n, m in motions.items()}
        lines = zip(table.mu, table.slip_and_drift_speed_rad_s, table.net_speed_m_s, strict=True)
        return Output(
            {f"table_{name}": getattr(table, name).tolist() for name in names} | steps,
            "net speed in mm/s (motor speed in rad/s)",
            "    mu  omega_c omega_net" + "".join(f"{omega:8.0f}" for omega in table.omega_rad_s),
            *(
                f"{mu:6.2f} {slip:8.1f} {drift:9.1f}"
                + "".join(f"{round(1e3 * speed, 3) + 0.0:8.3f}" for speed in speeds)
                for mu, (slip, drift), speeds in lines
            ),
            *(
                f"{text}: {1e6 * motion.net_displacement_m:.2f} µm per turn at "
                f"{motion.omega_rad_s:g} rad/s"
                for text, motion in zip(texts, motions.values(), strict=True)
            ),
            f"results: {out}",
        )


@dataclass(frozen=True, kw_only=True)
class DesignRobot(Command):
    """Print the motor speed for a robot speed, and designs that keep all feet on the floor at it.

    Results come from closed forms (the 1-DOF platform of Eq. (1) on three feet), and so do the
    changes of the speed with every parameter: eccentric mass, friction, weight, motor speed.
    """

    speed: Annotated[opt.Positive, tyro.conf.arg(metavar="MM_S")]
    """Wanted speed in mm/s."""
    preset: opt.PresetName = PAPER
    mu: opt.Friction = None

    def run(self, progress: Progress) -> Output:
        from cosim.machine.platform.design import design

        config = find_preset(self.preset).config().having("given", mu=self.mu)
        found = design(config.robot, config.motor, 1e-3 * self.speed)
        return Output(found, *_lines(found, config.robot))


def _lines(found: "Design", robot: "RobotParams") -> Iterator[str]:
    omega, least = found.motor_speed_rad_s, found.least_unbalance_kg_m
    yield (
        f"As it is (mu {robot.mu:g}, m r {1e6 * found.unbalance_kg_m:.3g} g mm), the robot has all "
        f"feet on the floor up to {1e3 * max(0.0, found.feet_down_m_s):.2f} mm/s, at "
        f"{found.foot_lift_rad_s:.0f} rad/s; it leaves the floor at {found.lift_off_rad_s:.0f}."
    )
    wanted = f"{1e3 * found.speed_m_s:.3g} mm/s"
    if omega is None:
        yield f"It leaves the floor before it reaches {wanted}."
    else:
        feet = "and no foot lifts" if found.feet_stay_down else "but feet lift in every turn"
        yield f"{wanted} takes {omega:.0f} rad/s, {feet}."
    if least is None:
        yield f"No m r from a hundredth to a hundred times its own gives {wanted} with feet down."
    else:
        yield (
            f"With feet down, {wanted} takes an m r of {1e6 * least:.3g} g mm per motor or more "
            f"({least / found.unbalance_kg_m:.3g} times its own), at "
            f"{found.unbalance_motor_speed_rad_s:.0f} rad/s or less."
        )
    if found.foot_radius_m is not None:
        fits = "" if found.foot_radius_m < robot.diameter_m / 2.0 else ", outside the body,"
        yield (
            f"At {omega:.0f} rad/s feet on a circle of {1e3 * found.foot_radius_m:.1f} mm or "
            f"more{fits} stay down (now {1e3 * robot.foot_radius_m:.3g} mm)."
        )
    if found.com_height_m is not None:
        yield (
            f"At {omega:.0f} rad/s they do under a centre of mass no higher than "
            f"{1e3 * found.com_height_m:.1f} mm (now {1e3 * robot.com_height_m:.3g} mm)."
        )
    names = ("m r", "friction", "mass", "motor speed")
    changes = zip(names, found.percent_per_percent.values(), strict=True)
    more = ", ".join(f"{name} {change:+.2f} %" for name, change in changes)
    yield f"Change of the speed for 1 % more: {more}."


@dataclass(frozen=True, kw_only=True)
class IdentifyRobot(Command):
    """Identify a robot: friction, centre of mass, feet, motors and camera delay from its track.

    Drive the robot with the motor speeds that --excite writes and record, with an overhead camera,
    a CSV file with the columns time, x, y, heading, omega_1, omega_2 (s, m, rad, rad/s; motors D
    and E, or those of the --preset in its order). The parameters are those of the best fit, each
    with an interval of 95 %.
    """

    track: Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="TRACK.csv")] = None
    """The track."""
    excite: Annotated[Path | None, tyro.conf.arg(metavar="FILE.csv")] = None
    """Write the motor speeds to drive a robot like the --preset with: time, omega_1, omega_2 …"""
    out: opt.Folder = Path("runs/robot")
    """Output folder: preset.toml, identification.json, report.md, tracks.svg."""
    preset: Annotated[str, tyro.conf.arg(metavar="NAME|FILE")] = PAPER
    """Machine that the robot is like, as in `minirobots run`: what is not identified, such as its
    mass, and what is assumed before anything is."""
    board: Annotated[tuple[float, float] | None, tyro.conf.arg(metavar="M M")] = None
    """Width and height of the board in m, with its corner at the origin; by default endless."""
    motor_fmu: opt.MotorFmuFile = None
    motor_parameters: opt.MotorParameters = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.track is None) == (self.excite is None):
            raise UserError("name a track to identify a robot from, or --excite FILE.csv")

    def run(self, progress: Progress) -> Output:
        from cosim.machine.identification.result import COLUMNS, identify, mass_text
        from cosim.machine.identification.track import (
            HOLD_S,
            excitation,
            read_track,
            write_excitation,
        )

        preset = find_preset(self.preset)
        if self.excite is not None:
            sequence = excitation(preset.config())
            write_excitation(require_suffix(self.excite, ".csv"), sequence)
            duration_s = len(sequence) * HOLD_S
            return Output(
                {"excitation": str(self.excite), "duration_s": duration_s},
                f"motor speeds for {duration_s:g} s in {self.excite}",
            )
        assert self.track is not None
        track = read_track(self.track, self.board, preset.config().robot)
        physics = Physics(
            preset=self.preset, motor_fmu=self.motor_fmu, motor_parameters=self.motor_parameters
        )
        fmu, config, out = physics.fmu(progress), physics.config(), self.out
        report = identify(track, self.track.name, preset, config, fmu, out, progress)
        return Output(
            report,
            lambda: show(COLUMNS, report.parameters, names=2),
            f"the mass is that of the preset; {mass_text(report)}",
            *(f"no intervals: {words}" for words in report.doubts),
            *(f"not identifiable from this track: {words}" for words in report.unidentifiable),
            f"results in {out}/: preset.toml, identification.json, report.md, tracks.svg",
        )


@dataclass(frozen=True, kw_only=True)
class BuildFmus(Command):
    """Build FMUs of one vibration motor and of an array of motors, which needs FMI 3.0.

    Without --fmi FMI 3.0 FMUs are written under the models' names, which the co-simulation uses;
    with --fmi the names include the standard, as in VibrationMotor_fmi2.fmu.

    With --sources the sources of an unpacked FMU, perhaps changed, are compiled for this machine,
    and the FMU is packed again: get such a folder by `minirobots fmu motor --out .` and `python -m
    zipfile -e VibrationMotor.fmu my_motor`. docs/own.md is a guide. Binaries of other platforms are
    left out.
    """

    what: Annotated[
        tyro.conf.Positional[tuple[What, ...]], tyro.conf.arg(metavar="{motor,motors}")
    ] = ()
    """What to build; by default both."""
    out: opt.Folder
    """Folder that receives the files; made if missing."""
    fmi: Literal["2", "3", "both"] | None = None
    """FMI standard to build for."""
    targets: tuple[TargetChoice, ...] = ("host",)
    """Platforms with binaries in the archive. A first build for Windows takes about a
    minute, every other build seconds."""

    sources: opt.Folder | None = None
    """Folder of an unpacked FMI 3.0 FMU with sources/buildDescription.xml, to compile and pack as
    an FMU of the folder's name."""

    def __post_init__(self) -> None:
        super().__post_init__()
        others = self.what, self.fmi, self.targets != ("host",)
        if self.sources and any(others):
            raise UserError("--sources is compiled for this machine only; leave other options out")
        if self.fmi == "2" and self.what == ("motors",):
            raise UserError("FMI 2 has no arrays, which motors need; use --fmi 3")

    def run(self, progress: Progress) -> Output:
        if self.sources:
            from cosim.fmi.fmu import Fmu
            from fmus.pack import pack_sources

            fmu = pack_sources(self.sources, self.out, progress)
            variables = [(v.causality, name) for name, v in Fmu(fmu).variables.items()]
            kinds = {
                f"{kind}s": [n for k, n in variables if k == kind] for kind in ("input", "output")
            }
            return Output({"fmu": str(fmu), **kinds})
        from fmus.build import build_fmus

        given = [TARGETS if choice == "all" else (choice,) for choice in self.targets]
        names = [host_target() if name == "host" else name for some in given for name in some]
        files: list[Path] = []
        models: list[Model] = [SHORT_NAMES[name] for name in self.what] or [*MODELS]
        for model in models:
            paths: dict[Fmi, Path] = {
                fmi: self.out / (f"{model}_fmi{fmi}.fmu" if self.fmi else f"{model}.fmu")
                for fmi in STANDARDS[model]
                if (self.fmi or "3") in (fmi, "both")
            }
            if paths:
                files += build_fmus(paths, list(dict.fromkeys(names)), progress, model)
        return Output({"files": [str(file) for file in files]})
