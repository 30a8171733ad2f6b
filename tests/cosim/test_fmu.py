"""Loading, checking and refusing motor FMUs."""

import re
import zipfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from fmpy.fmi3 import FMU3Slave

from cosim.assembly import new_motors
from cosim.config import CoSimConfig
from cosim.fmu import FmuError, MotorFmu


def rewritten(source: Path, target: Path, old: str, new: str) -> Path:
    """A copy of an FMU with its modelDescription changed."""
    with zipfile.ZipFile(source) as archive, zipfile.ZipFile(target, "w") as copy:
        for name in archive.namelist():
            data = archive.read(name)
            if name == "modelDescription.xml":
                assert old.encode() in data
                data = data.replace(old.encode(), new.encode())
            copy.writestr(name, data)
    return target


def test_instance_runs_from_its_defaults(motor_fmu):
    motor = MotorFmu(motor_fmu).instantiate("m")
    motor.set_inputs(np.array([700.0, 0.0, 0.0]), 0, 1e-5)
    for tick in range(3):
        motor.step(tick, 1, 1e-5)
    theta, omega, omega_dot = motor.outputs(3, 1e-5)
    voltage, current = motor.electrical(3, 1e-5)
    assert theta > 0.0
    assert omega > 0.0
    assert omega_dot > 0.0
    assert voltage == 3.0
    assert current > 0.0
    motor.close()


def test_threads_load_fmus_without_moving_the_process(motor_fmu):
    here, fmu = Path.cwd(), MotorFmu(motor_fmu)

    def load(number):
        for _ in range(20):
            fmu.instantiate(f"m{number}").close()

    with ThreadPoolExecutor(8) as threads:
        list(threads.map(load, range(8)))
    assert Path.cwd() == here


def test_missing_file_is_named(tmp_path):
    with pytest.raises(FmuError, match=r"nowhere\.fmu does not exist"):
        MotorFmu(tmp_path / "nowhere.fmu")


def test_file_that_is_no_archive_is_named(tmp_path):
    path = tmp_path / "broken.fmu"
    path.write_text("no archive")
    with pytest.raises(FmuError, match=r"broken\.fmu is broken"):
        MotorFmu(path)


def test_missing_variable_is_named(motor_fmu, tmp_path):
    path = rewritten(motor_fmu, tmp_path / "other.fmu", 'name="omega_dot"', 'name="acceleration"')
    with pytest.raises(FmuError, match="no Float64 output 'omega_dot'"):
        MotorFmu(path)


def test_every_instance_is_told_its_own_name(motor_fmu, monkeypatch):
    calls, instantiate = [], FMU3Slave.instantiate

    def logged(slave, **arguments):
        slave.fmiCallLogger = calls.append
        instantiate(slave, **arguments)

    monkeypatch.setattr(FMU3Slave, "instantiate", logged)
    motors = new_motors(MotorFmu(motor_fmu), CoSimConfig(), 2)
    told = [re.search('instanceName="(.*?)"', call) for call in calls]
    names = [match[1] for match in told if match]
    assert names == ["r1.D", "r1.E", "r2.D", "r2.E"] == [motor.name for motor in motors]


def test_binary_that_does_not_load_is_named_and_moves_nothing(motor_fmu, tmp_path):
    path, here = tmp_path / "foreign.fmu", Path.cwd()
    with zipfile.ZipFile(motor_fmu) as archive, zipfile.ZipFile(path, "w") as copy:
        for name in archive.namelist():
            binary = name.startswith("binaries/")
            copy.writestr(name, b"no library" if binary else archive.read(name))
    with pytest.raises(FmuError, match=r"foreign\.fmu, instance m, .* cannot be initialised"):
        MotorFmu(path).instantiate("m")
    assert Path.cwd() == here


def test_variables_are_found_by_name(motor_fmu, tmp_path):
    """Value references are the FMU's own business: the driver reads them."""
    fmu = MotorFmu(motor_fmu)
    variables = {v.name: v.valueReference for v in fmu.description.modelVariables}
    assert fmu.inputs.tolist() == [variables[n] for n in ("omega_des", "omega_noise", "d")]
    assert fmu.outputs.tolist() == [variables[n] for n in ("theta", "omega", "omega_dot")]


def test_foreign_platform_is_refused(motor_fmu, tmp_path):
    path = tmp_path / "foreign.fmu"
    with zipfile.ZipFile(motor_fmu) as archive, zipfile.ZipFile(path, "w") as copy:
        for name in archive.namelist():
            if not name.startswith("binaries/"):
                copy.writestr(name, archive.read(name))
    with pytest.raises(FmuError, match="no binary for"):
        MotorFmu(path)


def test_refused_parameter_names_instance_and_reason(motor_fmu):
    with pytest.raises(FmuError, match=r"instance r1\.D, .*J cannot be -1"):
        MotorFmu(motor_fmu).instantiate("r1.D", {"J": -1.0})


def test_unknown_parameter_is_named(motor_fmu):
    with pytest.raises(FmuError, match="no parameter 'colour'"):
        MotorFmu(motor_fmu).instantiate("m", {"colour": 1.0})
