"""Loading, checking and refusing motor FMUs."""

import re
import zipfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from fmpy.fmi3 import FMU3Slave

from cosim.base.arguments import ConfigError
from cosim.calibration.trial import Trial
from cosim.coupling import assembly
from cosim.coupling.assembly import Motors, check_motors
from cosim.coupling.fmu import FmuError, MotorFmu
from cosim.model.config import CoSimConfig
from cosim.model.params import TABLE_II, TIMING
from cosim.model.scenario_file import find_scenario
from tests.alone import CoSimulation

EQUAL = ((TABLE_II, TABLE_II),) * 2  # motors of two robots


def variable(root, name: str):
    """Element of a variable in a modelDescription."""
    (found,) = (v for v in root.find("ModelVariables") if v.get("name") == name)
    return found


def define(root, name: str, **base: str) -> None:
    """Define a unit."""
    unit = ElementTree.SubElement(root.find("UnitDefinitions"), "Unit", name=name)
    ElementTree.SubElement(unit, "BaseUnit", base)


def set_unit(element, unit: str | None) -> None:
    for attribute in ("unit", "displayUnit"):
        element.attrib.pop(attribute, None)
    if unit is not None:
        element.set("unit", unit)


def test_instance_runs_from_its_defaults(motor_fmu):
    motor = MotorFmu(motor_fmu).instantiate("m")
    motor.set_inputs(np.array([700.0, 0.0, 0.0]), 0, 1e-5)
    for tick in range(3):
        motor.step(tick, 1, 1e-5)
    theta, omega, omega_dot = motor.outputs(3, 1e-5)
    voltage, current, command, integral = motor.electrical(3, 1e-5)
    assert integral >= 0.0
    assert voltage == min(command, TABLE_II.V_s_max)
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


def test_archive_without_description_is_named(tmp_path):
    path = tmp_path / "empty.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("readme.txt", "no FMU")
    with pytest.raises(FmuError, match=r"empty\.fmu .*modelDescription\.xml"):
        MotorFmu(path)


def test_missing_variable_is_named(edited_fmu):
    path = edited_fmu(lambda root: variable(root, "omega_dot").set("name", "acceleration"))
    with pytest.raises(FmuError, match="no Float64 output 'omega_dot'"):
        MotorFmu(path)


@pytest.mark.parametrize(
    ("name", "unit"),
    [("omega_des", "rpm"), ("omega_noise", "Hz"), ("theta", "deg"), ("omega", "rpm"),
     ("omega_dot", "rad/s"), ("d", "mN.m"), ("V_s", "mV"), ("i", "degC")],
)  # fmt: skip
def test_variable_in_another_unit_is_refused(edited_fmu, name, unit):
    def edit(root):
        define(root, "rpm", rad="1", s="-1", factor="0.10471975511965977")
        define(root, "Hz", s="-1")
        define(root, "deg", rad="1", factor="0.017453292519943295")
        define(root, "mN.m", kg="1", m="2", s="-2", factor="1e-3")
        define(root, "mV", kg="1", m="2", s="-3", A="-1", factor="1e-3")
        define(root, "degC", A="1", offset="273.15")
        set_unit(variable(root, name), unit)

    with pytest.raises(FmuError, match=f"has '{name}' in {unit}; export it in "):
        MotorFmu(edited_fmu(edit))


def test_unit_of_a_declared_type_counts(edited_fmu):
    def edit(root):
        define(root, "rpm", rad="1", s="-1", factor="0.10471975511965977")
        types = root.find("TypeDefinitions")
        ElementTree.SubElement(types, "Float64Type", name="Speed", unit="rpm")
        set_unit(variable(root, "omega"), None)
        variable(root, "omega").set("declaredType", "Speed")

    with pytest.raises(FmuError, match=r"'omega' in rpm; .*rad/s"):
        MotorFmu(edited_fmu(edit))


def test_parameter_in_another_unit_is_refused(edited_fmu):
    def edit(root):
        define(root, "g.cm2", kg="1", m="2", factor="1e-7")
        set_unit(variable(root, "J"), "g.cm2")

    fmu = MotorFmu(edited_fmu(edit))
    fmu.instantiate("m").close()
    with pytest.raises(FmuError, match=r"'J' in g\.cm2; .*kg\.m2"):
        fmu.instantiate("m", {"J": TABLE_II.J})


@pytest.mark.parametrize(
    ("attributes", "message"),
    [({"tag": "Float32"}, "has 'omega' as Float32 output; export it as Float64 output"),
     ({"causality": "local"}, "has 'omega' as Float64 local; export it as Float64 output"),
     ({"dimension": "3"}, "has 'omega' as an array; export it as a scalar"),
     ({"dimension": "1"}, "has 'omega' as an array; export it as a scalar"),
     ({"clock": "99"}, "has 'omega' tied to a clock; export it without")],
)  # fmt: skip
def test_variable_of_another_kind_is_refused(edited_fmu, attributes, message):
    def edit(root):
        omega = variable(root, "omega")
        omega.tag = attributes.get("tag", omega.tag)
        if "causality" in attributes:
            omega.set("causality", attributes["causality"])
            structure = root.find("ModelStructure")
            for output in structure.findall("Output"):
                if output.get("valueReference") == omega.get("valueReference"):
                    structure.remove(output)
        if "dimension" in attributes:
            ElementTree.SubElement(omega, "Dimension", start=attributes["dimension"])
        if "clock" in attributes:
            omega.set("clocks", attributes["clock"])
            clock = {"name": "clock", "valueReference": "99", "causality": "input"}
            clock |= {"intervalVariability": "triggered"}
            ElementTree.SubElement(root.find("ModelVariables"), "Clock", clock)

    with pytest.raises(FmuError, match=message):
        MotorFmu(edited_fmu(edit))


def capability(**changes):
    """Edit of a modelDescription that changes attributes of its Co-Simulation interface."""
    return lambda root: root.find("CoSimulation").attrib.update(changes)


def test_more_motors_than_a_process_may_have_are_refused(edited_fmu):
    path = edited_fmu(capability(canBeInstantiatedOnlyOncePerProcess="true"))
    with pytest.raises(FmuError, match="OnlyOncePerProcess, and 4 motors are needed"):
        CoSimulation(find_scenario("2"), path)
    fmu = MotorFmu(path)
    with pytest.raises(FmuError, match="OnlyOncePerProcess, and 2 motors are needed"):
        Trial(fmu, CoSimConfig(), np.zeros(1), np.random.SeedSequence(0))
    fmu.instantiate("alone").close()


@pytest.mark.parametrize(
    ("internal", "step_s", "message"),
    [("1e-5", 1e-5, None),
     ("2e-5", 2e-5, None),
     ("2e-5", 1e-5, "communication_step_s = 1e-05 s .* fixedInternalStepSize .* 2e-05 s"),
     ("3e-5", 2e-5, "communication_step_s = 2e-05 s"),
     ("INF", 1e-5, "communication_step_s"),
     ("0", 1e-5, "fixedInternalStepSize = 0; export it with a positive one"),
     ("NaN", 1e-5, "fixedInternalStepSize = nan; export it with a positive one")],
)  # fmt: skip
def test_internal_step_must_divide_the_communication_step(edited_fmu, internal, step_s, message):
    fmu = MotorFmu(edited_fmu(capability(fixedInternalStepSize=internal)))
    config = CoSimConfig(timing=TIMING._replace(communication_step_s=step_s))
    if message is None:
        check_motors(fmu, config, 2)
    else:
        with pytest.raises((FmuError, ConfigError), match=message):
            check_motors(fmu, config, 2)


def test_every_instance_is_told_its_own_name(motor_fmu, monkeypatch):
    calls, instantiate = [], FMU3Slave.instantiate

    def logged(slave, **arguments):
        slave.fmiCallLogger = calls.append
        instantiate(slave, **arguments)

    monkeypatch.setattr(FMU3Slave, "instantiate", logged)
    motors = Motors(MotorFmu(motor_fmu), CoSimConfig(), 2)
    motors.restart(range(2), EQUAL)
    told = [re.search('instanceName="(.*?)"', call) for call in calls]
    names = [match[1] for match in told if match]
    assert names == ["r1.D", "r1.E", "r2.D", "r2.E"]
    assert "instance r2.E" in str(motors.error(3, "is tested", 1e-5))


def test_binary_that_does_not_load_is_named_and_moves_nothing(motor_fmu, tmp_path):
    path, here = tmp_path / "foreign.fmu", Path.cwd()
    with zipfile.ZipFile(motor_fmu) as archive, zipfile.ZipFile(path, "w") as copy:
        for name in archive.namelist():
            binary = name.startswith("binaries/")
            copy.writestr(name, b"no library" if binary else archive.read(name))
    with pytest.raises(FmuError, match=r"foreign\.fmu, instance m, .* cannot be initialised"):
        MotorFmu(path).instantiate("m")
    assert Path.cwd() == here


def test_variables_are_found_by_name(motor_fmu):
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


def test_a_violation_that_changes_no_result_is_a_warning(edited_fmu, caplog):
    path = edited_fmu(lambda root: variable(root, "K_T").attrib.pop("start"))
    MotorFmu(path).instantiate("m").close()
    (message,) = caplog.messages
    assert re.match(rf"motor FMU {path} violates the standard: .* has no start value", message)


def test_a_violation_that_may_change_a_result_is_refused(edited_fmu):
    path = edited_fmu(lambda root: variable(root, "K_T").set("descriptio", "m"))
    with pytest.raises(FmuError, match=r"violates the standard \(.*'descriptio'.*\); build one"):
        MotorFmu(path)


def test_refused_parameter_names_instance_and_reason(motor_fmu):
    with pytest.raises(FmuError, match=r"instance r1\.D, .*J cannot be -1"):
        MotorFmu(motor_fmu).instantiate("r1.D", {"J": -1.0})


def test_unknown_parameter_is_named(motor_fmu):
    with pytest.raises(FmuError, match="no parameter 'colour'"):
        MotorFmu(motor_fmu).instantiate("m", {"colour": 1.0})


def without_dimension(root, name):
    element = variable(root, name)
    element.remove(element.find("Dimension"))


@pytest.mark.parametrize(
    ("edit", "message"),
    [(lambda root: variable(root, "restart").set("name", "again"), "no Int64 input 'restart'"),
     (lambda root: without_dimension(root, "restart"), "no Int64 input 'restart' of their size"),
     (lambda root: without_dimension(root, "theta"),
      "has 'theta' as a scalar; export it as an array of the size of 'omega_des'"),
     (lambda root: variable(root, "n").set("causality", "parameter"),
      "'omega_des' as an array of fixed or of several dimensions; export it as a scalar")],
)  # fmt: skip
def test_arrays_of_another_kind_are_refused(edited_fmu, array_fmu, edit, message):
    with pytest.raises(FmuError, match=message):
        MotorFmu(edited_fmu(edit, array_fmu))


def test_arrays_of_fixed_parameters_are_for_equal_motors(edited_fmu, array_fmu):
    fixed = edited_fmu(lambda root: variable(root, "K_T").set("variability", "fixed"), array_fmu)
    motors = Motors(MotorFmu(fixed), CoSimConfig(motor=TABLE_II._replace(K_T=4e-4)), 2)
    own = TABLE_II._replace(K_T=4e-4, R=11.0)
    motors.restart([0, 1], ((own, own),) * 2)
    with pytest.raises(FmuError, match=r"'K_T' as fixed; .*tunable"):
        motors.restart([0, 1], EQUAL)
    motors.close()


def test_a_motor_without_an_initial_phase_is_refused_where_one_is_asked_for(edited_fmu, motor_fmu):
    other = edited_fmu(lambda root: variable(root, "theta_start").set("name", "begin"), motor_fmu)
    motors = Motors(MotorFmu(other), CoSimConfig(), 1)
    motors.restart([0], EQUAL[:1])
    with pytest.raises(FmuError, match="no parameter 'theta_start'; export"):
        motors.restart([0], EQUAL[:1], np.zeros((1, 2)))
    motors.close()


@pytest.mark.parametrize("fmu", ["motor_fmu", "array_fmu"])
def test_usual_motors_have_what_their_fmu_begins_with(fmu, request, monkeypatch):
    """Before and after a run with motors of their own, where that is not Table II as well."""
    usual = TABLE_II._replace(J=4e-9)
    monkeypatch.setattr(assembly, "TABLE_II", usual)
    motors = Motors(MotorFmu(request.getfixturevalue(fmu)), CoSimConfig(motor=usual), 1)
    inputs, speeds = np.zeros((6, 1)), []
    inputs[:2] = 700.0
    for own in (usual, usual._replace(J=2e-9), usual):
        motors.restart([0], ((usual, own),))
        motors.set_inputs(inputs, 1e-5)
        motors.step(3, 1e-5)
        outputs = np.zeros((6, 1))
        motors.get_outputs(outputs, 1e-5)
        speeds.append(tuple(outputs[2:4, 0]))
    motors.close()
    (d, e), (same, other), again = speeds
    assert d == e == same < other
    assert again == (d, e)


def test_an_array_that_fails_is_named_with_its_time(array_fmu):
    motors = Motors(MotorFmu(array_fmu), CoSimConfig(), 2)
    motors.restart([0, 1], EQUAL)
    motors.step(3, 1e-5)
    inputs = np.zeros((6, 2))
    inputs[2, 1] = np.nan
    with pytest.raises(FmuError, match=r"instance motors, at 0\.00003 s .*: .*omega_noise"):
        motors.set_inputs(inputs, 1e-5)
    motors.close()
