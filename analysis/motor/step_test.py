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

from analysis.motor.instance import require_parameters, responses
from analysis.motor.loop_options import StepTest
from analysis.reading.motor_test import LOOPS, SIGNALS, Response
from cosim.base.arguments import validate_unique
from cosim.base.colours import BLUE, VERMILION, rgba
from cosim.base.errors import UserError
from cosim.fmi.motor import MotorFmu
from cosim.model.params import MotorParams
from cosim.recording.blueprint import plain_blueprint
from cosim.recording.file import Recording, scalars, simulated

SAMPLE_S = 1e-3
_COLOURS = {"open_loop": rgba(VERMILION), "closed_loop": rgba(BLUE)}


def simulate(path: Path, test: StepTest, loop: str) -> Response:
    """Run the FMU in one of LOOPS."""
    count = round(test.duration / SAMPLE_S)
    third = np.arange(count + 1) * 3 // (count + 1)
    disturbance = test.d * np.array([0.0, 1.0, -1.0])[third]
    given = validate_unique("motor_parameters", test.motor_parameters)
    start = {
        **given,
        "omega_des": test.omega_des,
        "V_in": test.open_loop_v,
        "closed_loop": loop == "closed_loop",
    }
    try:
        motor = MotorFmu(path)
        require_parameters(motor, given)
        outputs = ("omega", "V_s", "i")
        rows = responses(motor, start, outputs, count, SAMPLE_S, {"d": disturbance})
    except Exception as error:  # fmpy raises plain Exceptions
        raise UserError(f"motor FMU {path} cannot be tested: {error}") from error
    time_s, set_point = np.arange(count + 1) * SAMPLE_S, np.full(count + 1, test.omega_des)
    omega, voltage, current = rows.T
    return Response(time_s, omega, set_point, voltage, current, disturbance)


def record(out: Path, fmu: Path, test: StepTest) -> None:
    """Run both loops and write the recording (.rrd)."""
    found = {loop: simulate(fmu, test, loop) for loop in LOOPS}
    with Recording(out, "motor test", _blueprint()) as file:
        for loop, response in found.items():
            lines = rr.SeriesLines(
                names=loop.replace("_", " "),
                colors=np.array([_COLOURS[loop]], dtype=np.uint32),
                aggregation_policy="MinMax",
            )
            times = simulated(response.time_s)
            for signal in SIGNALS:
                entity = f"/sim/{loop}/{signal}"
                file.static(entity, lines)
                file.columns(entity, times, scalars(getattr(response, signal)))
        facts = asdict(test)
        facts["duration_s"] = facts.pop("duration")
        facts["motor_parameters"] = dict(test.motor_parameters)
        # of this motor, as far as its FMU exposes them
        facts["parameters"] = MotorFmu(fmu).read(MotorParams._fields, facts["motor_parameters"])
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
