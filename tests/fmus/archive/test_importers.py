"""The FMU in importers not written here gives the trajectory of the project's own driver."""

import json
import subprocess
import sys
from pathlib import Path

import fmpy
import numpy as np
import pytest

from cosim.base.jit import kernel
from cosim.coupling.calls import do_step
from cosim.coupling.fmu import MotorFmu
from cosim.fmi.abi import exchange_3

STEPS, STEP_S, SET_POINT = 1000, 1e-3, 700.0
SAME = 1e-9


@kernel
def step_through(instance, step_function, get_function, reference, speeds, step_s):
    status = 0
    for k in range(speeds.shape[0]):
        status = max(status, do_step(step_function, instance, k * step_s, step_s))
        value = speeds.ctypes.data + 8 * k
        where = reference.ctypes.data
        status = max(status, exchange_3(get_function, (instance, where, 1, value, 1)))
    return status


@pytest.fixture(scope="module")
def own(fmu) -> np.ndarray:
    """omega after every step, by the compiled calls of the co-simulation."""
    motor = MotorFmu(fmu).instantiate("motor", {"omega_des": SET_POINT})
    speeds, functions = np.empty(STEPS), motor.addresses
    reference = motor.fmu.outputs[1:2].copy()
    step, get = functions.do_step, functions.get_float64
    assert step_through(motor.instance, step, get, reference, speeds, STEP_S) == 0
    motor.close()
    assert speeds[-1] > 680.0
    return speeds


def test_fmpy(fmus, fmi, own):
    result = fmpy.simulate_fmu(
        str(fmus[fmi]),
        stop_time=STEPS * STEP_S,
        output_interval=STEP_S,
        start_values={"omega_des": SET_POINT},
        output=["omega"],
    )
    assert result["omega"][1:] == pytest.approx(own, rel=SAME)


@pytest.mark.parametrize(
    ("importer", "standard"), [("ecospy", 2), ("ecospy", 3), ("libcosimpy", 2)]
)
def test_other_importers(fmus, importer, standard, own):
    script = Path(__file__).with_name("importer_run.py")
    run = subprocess.run(
        [sys.executable, str(script), importer, str(fmus[standard])],
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert run.returncode == 0, run.stderr
    assert json.loads(run.stdout.splitlines()[-1]) == pytest.approx(own, rel=SAME)
