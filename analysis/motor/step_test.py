"""The test of Fig. 7: step responses of a motor in open and closed loop, as a recording.

The motor FMU runs alone, through fmpy, once with a constant voltage and once with its PI speed
loop. A disturbance torque acts from one third of the time on, and against the motion from two
thirds. `analysis.reading.motor_test` reads the recording, `analysis.figures.fig07` draws it.
"""

from dataclasses import asdict
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from analysis.motor.instance import require_parameters, running
from analysis.motor.loop_options import StepTest
from analysis.reading.motor_test import LOOPS, SIGNALS, Response
from cosim.base.arguments import validate_unique
from cosim.base.errors import UserError
from cosim.coupling.fmu import MotorFmu
from cosim.model.params import MotorParams
from cosim.recording.blueprint import plain_blueprint
from cosim.recording.file import Recording, scalars, simulated

SAMPLE_S = 1e-3
_COLOURS = {"open_loop": 0xD55E00FF, "closed_loop": 0x0072B2FF}


def simulate(path: Path, test: StepTest, loop: str) -> Response:
    """Run the FMU.

    Args:
        path: of the FMU.
        test: what is done to it.
        loop: one of LOOPS.

    Raises:
        UserError: the FMU is missing, broken or refuses a call.
    """
    try:
        return _simulate(MotorFmu(path), test, loop)
    except Exception as error:  # fmpy raises plain Exceptions
        raise UserError(f"motor FMU {path} cannot be tested: {error}") from error


def _simulate(motor: MotorFmu, test: StepTest, loop: str) -> Response:
    count = round(test.duration / SAMPLE_S)
    rows = np.empty((count + 1, 3))
    third = np.arange(count + 1) * 3 // (count + 1)
    disturbance = test.d * np.array([0.0, 1.0, -1.0])[third]
    given = validate_unique("motor_parameters", test.motor_parameters)
    require_parameters(motor, given)
    start = {
        **given,
        "omega_des": test.omega_des,
        "V_in": test.open_loop_v,
        "closed_loop": loop == "closed_loop",
    }
    with running(motor, start) as (fmu, reference):
        wanted = [reference[name] for name in ("omega", "V_s", "i")]
        for k in range(count + 1):
            fmu.setFloat64([reference["d"]], [disturbance[k]])
            rows[k] = fmu.getFloat64(wanted)
            if k < count:
                fmu.doStep(k * SAMPLE_S, SAMPLE_S)
    set_point = np.full(count + 1, test.omega_des)
    omega, voltage, current = rows.T
    time_s = np.arange(count + 1) * SAMPLE_S
    return Response(time_s, omega, set_point, voltage, current, disturbance)


def record(out: Path, fmu: Path, test: StepTest) -> None:
    """Run both loops and write the recording.

    Args:
        out: recording to write (.rrd).
        fmu: of the motor.
        test: what is done to it.

    Raises:
        UserError: the FMU is missing, broken or refuses a call.
        UserError: the recording cannot be written.
    """
    responses = {loop: simulate(fmu, test, loop) for loop in LOOPS}
    with Recording(out, "motor test", _blueprint()) as file:
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
        facts = asdict(test)
        facts["duration_s"] = facts.pop("duration")
        facts["motor_parameters"] = dict(test.motor_parameters)
        known = MotorFmu(fmu).read(MotorParams._fields, facts["motor_parameters"])
        facts["parameters"] = known  # of this motor, as far as its FMU exposes them
        file.properties("motor_test", facts)


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
    return plain_blueprint(
        rrb.Vertical(*views), rrb.TimePanel(timeline="sim_time", state="collapsed")
    )
