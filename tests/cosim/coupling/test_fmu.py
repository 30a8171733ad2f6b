"""Loading, checking and refusing motor FMUs."""

import re
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from fmpy.fmi3 import FMU3Slave
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cosim.base.arguments import ConfigError
from cosim.calibration.trial import Trial
from cosim.coupling.assembly import check_motors
from cosim.fmi.fmu import FmuError
from cosim.fmi.motor import PHASE, Motor, MotorFmu, _units
from cosim.fmi.motors import Motors
from cosim.model.config import CoSimConfig
from cosim.model.params import TABLE_II, TIMING, MotorParams
from cosim.model.scenario_file import find_scenario
from tests.alone import CoSimulation, edited

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
    motor = Motor(MotorFmu(motor_fmu), "m")
    motor.set(motor.fmu.inputs, np.array([700.0, 0.0, 0.0]))
    for tick in range(3):
        motor.step(tick * 1e-5, 1e-5)
    assert min(motor.get(motor.fmu.outputs)) > 0.0
    voltage, current, command, integral = motor.get(motor.fmu.electrical)
    assert voltage == min(command, TABLE_II.V_s_max) == 3.0
    assert current > 0.0 <= integral
    motor.close()


def test_threads_load_fmus_without_moving_the_process(motor_fmu):
    here, fmu = Path.cwd(), MotorFmu(motor_fmu)

    def load(number):
        for _ in range(20):
            Motor(fmu, f"m{number}").close()

    with ThreadPoolExecutor(8) as threads:
        list(threads.map(load, range(8)))
    assert Path.cwd() == here


def without(original, path, left_out, content=None):
    """A copy of an archive in which what begins with a name is left out, or has other content."""
    return edited(original, path, lambda name, old: content if name.startswith(left_out) else old)


@pytest.mark.parametrize(
    ("make", "message"),
    [(lambda _, path: path, r"odd\.fmu does not exist"),
     (lambda _, path: path.write_text("no archive") and path, r"odd\.fmu is broken"),
     (lambda fmu, path: without(fmu, path, "model"), r"odd\.fmu .*modelDescription\.xml"),
     (lambda fmu, path: without(fmu, path, "binaries/"), "no binary for")],
)  # fmt: skip
def test_files_that_are_no_fmu_for_this_machine_are_named(motor_fmu, tmp_path, make, message):
    with pytest.raises(FmuError, match=message):
        MotorFmu(make(motor_fmu, tmp_path / "odd.fmu"))


def test_binary_that_does_not_load_is_named_and_moves_nothing(motor_fmu, tmp_path):
    here = Path.cwd()
    path = without(motor_fmu, tmp_path / "foreign.fmu", "binaries/", b"no library")
    with pytest.raises(FmuError, match=r"foreign\.fmu, instance m, .* cannot be initialised"):
        Motor(MotorFmu(path), "m")
    assert Path.cwd() == here


def edit_unit(name, unit):
    def edit(root):
        define(root, "rpm", rad="1", s="-1", factor="0.10471975511965977")
        define(root, "Hz", s="-1")
        define(root, "deg", rad="1", factor="0.017453292519943295")
        define(root, "mN.m", kg="1", m="2", s="-2", factor="1e-3")
        define(root, "mV", kg="1", m="2", s="-3", A="-1", factor="1e-3")
        define(root, "degC", A="1", offset="273.15")
        define(root, "g.cm2", kg="1", m="2", factor="1e-7")
        set_unit(variable(root, name), unit)

    return edit


def edit_declared_type(root):
    edit_unit("omega", None)(root)
    types = root.find("TypeDefinitions")
    ElementTree.SubElement(types, "Float64Type", name="Speed", unit="rpm")
    variable(root, "omega").set("declaredType", "Speed")


def edit_causality(root):
    omega, structure = variable(root, "omega"), root.find("ModelStructure")
    omega.set("causality", "local")
    for output in structure.findall("Output"):
        if output.get("valueReference") == omega.get("valueReference"):
            structure.remove(output)


def edit_clock(root):
    variable(root, "omega").set("clocks", "99")
    clock = {"name": "clock", "valueReference": "99", "causality": "input"}
    clock |= {"intervalVariability": "triggered"}
    ElementTree.SubElement(root.find("ModelVariables"), "Clock", clock)


def edit_dimension(size):
    return lambda root: ElementTree.SubElement(variable(root, "omega"), "Dimension", start=size)


UNITS = {"omega_des": "rpm", "omega_noise": "Hz", "theta": "deg", "omega": "rpm",
         "omega_dot": "rad/s", "d": "mN.m", "V_s": "mV", "i": "degC"}  # fmt: skip


@pytest.mark.parametrize(
    ("edit", "message"),
    [*((edit_unit(name, unit), f"has '{name}' in {unit}; export it in ")
       for name, unit in UNITS.items()),
     (edit_declared_type, r"'omega' in rpm; .*rad/s"),
     (lambda root: variable(root, "omega_dot").set("name", "acceleration"),
      "no Float64 output 'omega_dot'"),
     (lambda root: setattr(variable(root, "omega"), "tag", "Float32"),
      "has 'omega' as Float32 output; export it as Float64 output"),
     (edit_causality, "has 'omega' as Float64 local; export it as Float64 output"),
     (edit_dimension("3"), "has 'omega' as an array; export it as a scalar"),
     (edit_dimension("1"), "has 'omega' as an array; export it as a scalar"),
     (edit_clock, "has 'omega' tied to a clock; export it without")],
)  # fmt: skip
def test_variable_of_another_kind_is_refused(edited_fmu, edit, message):
    with pytest.raises(FmuError, match=message):
        MotorFmu(edited_fmu(edit))


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    name=st.sampled_from([*_units(), "L"]),
    factor=st.sampled_from([1e-3, 1e3, 2.0 * np.pi / 60.0, 1.0]),
    offset=st.sampled_from([0.0, 273.15]),
    declared=st.booleans(),
)
def test_values_in_another_unit_are_never_taken_as_they_are(
    edited_fmu, name, factor, offset, declared
):
    """Whatever is set or read, however its unit is declared: a display unit is none."""

    def edit(root):
        if name == "L":
            copy = ElementTree.SubElement(root.find("ModelVariables"), "Float64")
            copy.attrib.update(variable(root, "K_p").attrib | {"name": "L", "valueReference": "99"})
        element = variable(root, name)
        old = element.get("unit")
        (base,) = (u[0].attrib for u in root.find("UnitDefinitions") if u.get("name") == old)
        define(root, "other", **base | {"factor": repr(factor), "offset": repr(offset)})
        set_unit(element, None if declared else "other")
        if declared:
            types = root.find("TypeDefinitions")
            ElementTree.SubElement(types, "Float64Type", name="Other", unit="other")
            element.set("declaredType", "Other")

    def use():
        path = edited_fmu(edit)
        MotorFmu(path, open_loop=True)
        fmu = MotorFmu(path)
        fmu.read(MotorParams._fields, {})
        fmu.parameter(PHASE)
        fmu.parameter("omega_start")
        if name == "L":
            fmu.parameter("L")

    same = name == "time" or (factor, offset) == (1.0, 0.0)
    refused = pytest.raises(FmuError, match=f"has '{name}' in other; export it in ")
    with nullcontext() if same else refused:
        use()


def test_parameters_of_another_kind_and_refused_ones_are_named(edited_fmu, motor_fmu):
    fmu = MotorFmu(edited_fmu(edit_unit("J", "g.cm2")))
    Motor(fmu, "m").close()
    with pytest.raises(FmuError, match=r"'J' in g\.cm2; .*kg\.m2"):
        Motor(fmu, "m", {"J": TABLE_II.J})
    with pytest.raises(FmuError, match="no parameter 'colour'"):
        Motor(fmu, "m", {"colour": 1.0})
    with pytest.raises(FmuError, match=r"instance r1\.D, .*J cannot be -1"):
        Motor(MotorFmu(motor_fmu), "r1.D", {"J": -1.0})


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
    Motor(fmu, "alone").close()


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
    refused = pytest.raises((FmuError, ConfigError), match=message) if message else nullcontext()
    with refused:
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


def test_variables_are_found_by_name(motor_fmu):
    """Value references are the FMU's own business: the driver reads them."""
    fmu = MotorFmu(motor_fmu)
    variables = {v.name: v.valueReference for v in fmu.description.modelVariables}
    assert fmu.inputs.tolist() == [variables[n] for n in ("omega_des", "omega_noise", "d")]
    assert fmu.outputs.tolist() == [variables[n] for n in ("theta", "omega", "omega_dot")]


def test_a_violation_that_changes_no_result_is_a_warning(edited_fmu, caplog):
    path = edited_fmu(lambda root: variable(root, "K_T").attrib.pop("start"))
    Motor(MotorFmu(path), "m").close()
    (message,) = caplog.messages
    assert re.match(rf"motor FMU {path} violates the standard: .* has no start value", message)


def test_a_violation_that_may_change_a_result_is_refused(edited_fmu):
    path = edited_fmu(lambda root: variable(root, "K_T").set("descriptio", "m"))
    with pytest.raises(
        FmuError, match=r"violates the standard \(.*'descriptio'.*\); export it again"
    ):
        MotorFmu(path)


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
    monkeypatch.setattr("cosim.fmi.motors.TABLE_II", usual)
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
