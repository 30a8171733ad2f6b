"""`python -m analysis.motor_test`: records the test of Fig. 7, a motor in open and closed loop.

The motor FMU runs alone, through fmpy, once with a constant voltage and once with its PI speed
loop. A disturbance torque acts from one third of the time on, and against the motion from two
thirds.
`analysis.figures.fig07` draws the recording; `read` gives its signals as arrays.
"""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
import tyro
from fmpy.simulation import instantiate_fmu

from cosim.base.errors import UserError, run_command
from cosim.base.params import FIG_7
from cosim.coupling.fmu import MotorFmu
from cosim.reading.rrd import RecordingReadError, Signal, read_rrd
from cosim.recording.file import Recording, properties, scalars, simulated
from fmus.build import cached_fmu

LOOPS = ("open_loop", "closed_loop")
SAMPLE_S = 1e-3
# Entities below /sim/<loop>, and what they hold.
SIGNALS = ("omega", "omega_des", "voltage", "current", "disturbance")
_COLOURS = {"open_loop": 0xD55E00FF, "closed_loop": 0x0072B2FF}


class MotorTestError(UserError):
    """A motor test that cannot be run or read; the message names the file and the mend."""


class Response(NamedTuple):
    """Signals of one run; float64 arrays (n,) in SI units, one value per `SAMPLE_S`.

    Attributes:
        time_s: from 0 on.
        omega: speed of the shaft, rad/s.
        omega_des: set point, rad/s.
        voltage: at the motor, V.
        current: A.
        disturbance: torque on the shaft, N m, from this time on.
    """

    time_s: np.ndarray
    omega: np.ndarray
    omega_des: np.ndarray
    voltage: np.ndarray
    current: np.ndarray
    disturbance: np.ndarray


@dataclass(frozen=True)
class MotorTest:
    """Record the step responses of Fig. 7: one motor in open loop, and one in closed loop.

    From one third of the time on a disturbance torque drives the shaft, from two thirds on it
    brakes it: the open loop settles elsewhere, the closed loop returns to its set point.
    """

    out: Path = Path("runs/motor_test.rrd")
    """Recording to write."""
    duration_s: float = 6.0
    """Simulated time."""
    omega_des: float = FIG_7.omega_des
    """Set point of the closed loop in rad/s."""
    open_loop_v: float = FIG_7.open_loop_V
    """Voltage of the open loop in V."""
    d: float = FIG_7.d
    """Disturbance torque in N m."""
    fmu: Path | None = None
    """Motor FMU (FMI 3.0) to test. Left out: the project's own."""


def simulate(options: MotorTest, loop: str) -> Response:
    """Run the FMU.

    Args:
        options: the test.
        loop: one of LOOPS.

    Raises:
        MotorTestError: the FMU is missing, broken or refuses a call.
    """
    path = options.fmu or cached_fmu()
    try:
        return _simulate(MotorFmu(path), options, loop)
    except Exception as error:  # fmpy raises plain Exceptions
        raise MotorTestError(f"motor FMU {path} cannot be tested: {error}") from error


def _simulate(motor: MotorFmu, options: MotorTest, loop: str) -> Response:
    reference = {v.name: v.valueReference for v in motor.description.modelVariables}
    fmu: Any = instantiate_fmu(
        motor.folder, motor.description, fmi_type="CoSimulation", debug_logging=True
    )
    try:
        fmu.setBoolean([reference["closed_loop"]], [loop == "closed_loop"])
        inputs = [reference["omega_des"], reference["V_in"]]
        fmu.setFloat64(inputs, [options.omega_des, options.open_loop_v])
        fmu.enterInitializationMode()
        fmu.exitInitializationMode()
        count = round(options.duration_s / SAMPLE_S)
        wanted = [reference[name] for name in ("omega", "V_s", "i")]
        rows = np.empty((count + 1, 3))
        third = np.arange(count + 1) * 3 // (count + 1)
        disturbance = options.d * np.array([0.0, 1.0, -1.0])[third]
        for k in range(count + 1):
            fmu.setFloat64([reference["d"]], [disturbance[k]])
            rows[k] = fmu.getFloat64(wanted)
            if k < count:
                fmu.doStep(k * SAMPLE_S, SAMPLE_S)
        fmu.terminate()
    finally:
        fmu.freeInstance()
    set_point = np.full(count + 1, options.omega_des)
    omega, voltage, current = rows.T
    time_s = np.arange(count + 1) * SAMPLE_S
    return Response(time_s, omega, set_point, voltage, current, disturbance)


def record(options: MotorTest) -> Path:
    """Run both loops and write the recording.

    Returns:
        Path of the recording.

    Raises:
        MotorTestError: the FMU is missing, broken or refuses a call.
        RecordingError: the recording cannot be written.
    """
    responses = {loop: simulate(options, loop) for loop in LOOPS}
    with Recording(options.out, "motor test", _blueprint()) as file:
        for loop, response in responses.items():
            times = simulated(response.time_s)
            for signal in SIGNALS:
                entity = f"/sim/{loop}/{signal}"
                file.static(
                    entity,
                    rr.SeriesLines(
                        names=loop.replace("_", " "),
                        colors=np.array([_COLOURS[loop]], dtype=np.uint32),
                        aggregation_policy="MinMax",
                    ),
                )
                file.columns(entity, times, scalars(getattr(response, signal)))
        # Not where it was written: equal tests give equal recordings.
        facts = {k: v for k, v in asdict(options).items() if k not in {"out", "fmu"}}
        file.stream.send_property("motor_test", properties(facts))
    return options.out


def _blueprint() -> rrb.Blueprint:
    views = [
        rrb.TimeSeriesView(
            origin="/", contents=[f"/sim/{loop}/{signal}" for loop in LOOPS], name=title
        )
        for signal, title in (
            ("omega", "speed rad/s"),
            ("voltage", "voltage V"),
            ("current", "current A"),
            ("disturbance", "disturbance torque N m"),
        )
    ]
    return rrb.Blueprint(
        rrb.Vertical(*views),
        rrb.TimePanel(timeline="sim_time", state="collapsed"),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        auto_layout=False,
        auto_views=False,
    )


def read(path: Path) -> dict[str, Response]:
    """Signals of a recording, by loop.

    Raises:
        MotorTestError: there is no such recording, or it is none of a motor test.
    """
    try:
        signals = read_rrd(path).signals
        return {loop: _response(signals, loop) for loop in LOOPS}
    except (RecordingReadError, KeyError) as error:
        raise MotorTestError(
            f"{path} is no recording of a motor test ({error}); "
            "make one with `python -m analysis.motor_test`"
        ) from error


def _response(signals: dict[str, Signal], loop: str) -> Response:
    held = [signals[f"/sim/{loop}/{signal}"] for signal in SIGNALS]
    return Response(held[0].time_s, *(signal.values for signal in held))


def main() -> None:
    """Command line."""
    print(f"recording: {record(tyro.cli(MotorTest, prog='python -m analysis.motor_test'))}")


if __name__ == "__main__":
    run_command(main)
