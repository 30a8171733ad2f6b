"""Parameters of motor FMUs: what is shown is what the FMU has."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from cosim.base.arguments import ConfigError
from cosim.base.provenance import digest_of
from cosim.fmi.fmu import FmuError
from cosim.fmi.motor import MotorFmu, with_motor
from cosim.model.config import CoSimConfig
from cosim.model.params import TABLE_II, MotorParams
from cosim.model.scenario import Scenario
from cosim.model.world import World
from cosim.simulation.batch import DRIVERS
from cosim.simulation.options import Physics, SimulationOptions
from fmus import models
from fmus.build import build_fmu, built_in_model
from tests.alone import CoSimulation

HEAVY = 2.0 * TABLE_II.J
ONE = Scenario("one", "", ((5, 5),), (((15, 15),),))


def changed_fmu(folder, file, old, new):
    """A user's motor: the built-in one with a change of its sources."""
    sources = shutil.copytree(models.ROOT, folder / "sources")
    path = sources / "vibration_motor" / file
    text = path.read_text()
    assert text.count(old) == 1
    path.write_text(text.replace(old, new))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(models, "ROOT", sources)
        return build_fmu(folder, "VibrationMotor")


@pytest.fixture(scope="session")
def heavy_fmu(tmp_path_factory):
    """One with another inertia of its own."""
    old, new = (f'start="{value!r}"' for value in (TABLE_II.J, HEAVY))
    return changed_fmu(tmp_path_factory.mktemp("heavy"), "VibrationMotor.xml", old, new)


@pytest.fixture
def without(edited_fmu):
    """A motor FMU that does not expose some parameters."""

    def make(*names):
        def rename(root):
            for variable in root.find("ModelVariables"):
                if variable.get("name") in names:
                    variable.set("name", variable.get("name") + "_hidden")

        return edited_fmu(rename)

    return make


def motors_after(fmu, config, steps=1, **options):
    system = CoSimulation(ONE, fmu, config, **options)
    system.reset(((15, 15),), 0)
    omega = [system.step(np.array([2])).samples.omega for _ in range(steps)]
    system.close()
    return np.concatenate(omega)


def test_the_built_in_motors_are_those_of_table_ii(motor_fmu, array_fmu):
    for path in (motor_fmu, array_fmu):
        assert built_in_model(path)
        assert with_motor(CoSimConfig(), path) == CoSimConfig()
        read = MotorFmu(path).read(MotorParams._fields, {})
        assert MotorParams(**read) == TABLE_II


def test_an_fmu_is_shown_with_its_own_parameters(heavy_fmu):
    config = with_motor(CoSimConfig(), heavy_fmu)
    table = config.table()
    assert config.motor == TABLE_II._replace(J=HEAVY)
    assert config.motor_fmu == digest_of(heavy_fmu)
    assert {table[n]["source"] for n in MotorParams._fields} == {"motor FMU VibrationMotor.fmu"}
    assert table["J"]["value"] == HEAVY
    assert with_motor(config, heavy_fmu) is config


@pytest.mark.long
@pytest.mark.parametrize("driver", sorted(set(DRIVERS) - {"fmpy"}))
def test_parameters_are_set_through_fmi_with_every_driver(driver, motor_fmu, heavy_fmu):
    """An FMU that is given an inertia turns as one that has it, whatever drives it."""
    timing = CoSimConfig().timing._replace(rl_step_s=0.05)
    usual = CoSimConfig(timing=timing)
    given = replace(usual, motor=TABLE_II._replace(J=HEAVY), motor_parameters=(("J", HEAVY),))
    light = replace(usual, motor_parameters=(("J", TABLE_II.J),))
    found = {
        name: motors_after(fmu, config, driver=driver)
        for name, fmu, config in (
            ("own", heavy_fmu, usual),
            ("given", motor_fmu, given),
            ("usual", motor_fmu, usual),
            ("back", heavy_fmu, light),
        )
    }
    assert np.array_equal(found["own"], found["given"])
    assert np.array_equal(found["usual"], found["back"])
    assert not np.array_equal(found["own"], found["usual"])


def test_parameters_are_set_through_fmpys_samples_too(array_fmu):
    timing = CoSimConfig().timing._replace(rl_step_s=0.05)
    usual = CoSimConfig(timing=timing)
    given = replace(usual, motor=TABLE_II._replace(J=HEAVY), motor_parameters=(("J", HEAVY),))
    found = [motors_after(array_fmu, given, driver=driver) for driver in ("fmpy", "compiled")]
    assert np.array_equal(found[0], found[1])
    assert not np.array_equal(found[0], motors_after(array_fmu, usual))


def test_what_an_fmu_does_not_expose_is_unknown(without):
    config = with_motor(CoSimConfig(), without("K_T", "J"))
    table = config.table()
    assert (table["K_T"]["value"], table["K_T"]["source"]) == ("unknown", "unknown")
    assert table["J"]["source"] == "unknown: that of the body is assumed"
    assert table["R"]["source"] == "motor FMU edited.fmu"
    with pytest.raises(ConfigError, match="does not expose K_T, which --open-loop motors needs"):
        with_motor(CoSimConfig(open_loop=("motors",)), without("K_T"))
    with pytest.raises(FmuError, match="has no parameter 'K_T'"):
        with_motor(replace(CoSimConfig(), motor_parameters=(("K_T", 1e-4),)), without("K_T"))


def test_what_is_set_in_every_control_period_is_no_parameter():
    with pytest.raises(ConfigError, match="motor_parameters names omega_des, which is set in"):
        Physics(motor_parameters=(("omega_des", 3.0),)).config()


def test_a_parameter_is_given_once():
    with pytest.raises(ConfigError, match="motor_parameters gives J twice; leave one out"):
        Physics(motor_parameters=(("J", 5e-9), ("J", 6e-9))).config()


def test_an_impossible_parameter_names_the_fmu(heavy_fmu):
    given = replace(CoSimConfig(), motor_parameters=(("m", -1.0),))
    with pytest.raises(FmuError, match=r"FMU VibrationMotor\.fmu"):
        with_motor(given, heavy_fmu)


def test_options_set_parameters_and_results_are_known_by_them():
    plain, given = (
        SimulationOptions().config(),
        SimulationOptions(motor_parameters=(("J", 5e-9),)).config(),
    )
    assert given.motor.J == 5e-9
    assert given.table()["J"] == plain.table()["J"] | {
        "value": 5e-9, "source": "given by motor_parameters",
    }  # fmt: skip
    extra = SimulationOptions(motor_parameters=(("L", 1e-5),)).config().table()
    assert extra["L"]["value"] == 1e-5
    assert "L" not in plain.table()
    # heavier masses lift the robot off earlier: its speeds are theirs
    heavier = SimulationOptions(motor_parameters=(("m", 2.0 * TABLE_II.m),)).config()
    assert heavier.steering.max_speed_rad_s < heavier.lift_off_rad_s < 0.8 * plain.lift_off_rad_s
    assert "Table II" not in {CoSimConfig(motor=TABLE_II._replace(J=5e-9)).table()["J"]["source"]}


def test_motors_differ_about_what_the_fmu_has(heavy_fmu):
    config = with_motor(CoSimConfig().in_world(World(motor_spread=0.1)), heavy_fmu)
    system = CoSimulation(ONE, heavy_fmu, config)
    system.reset(((15, 15),), 0)
    drawn = [motor.J for pair in system.episode.drawn.motors for motor in pair]
    assert all(0.6 * HEAVY < value < 1.4 * HEAVY and value != HEAVY for value in drawn)
    system.close()


@pytest.mark.long
def test_motors_that_are_too_weak_are_told(command, tmp_path):
    weak = ("--motor-parameter", "V_s_max=0.2", "--motor-parameter", "J=3e-9")
    done = command("run", "--scenario", "1a", "--method", "shortest", "--out", tmp_path, *weak)
    assert done.returncode == 2
    assert "the motors are too weak to move the robot: they reach" in done.stderr


@pytest.mark.long
@pytest.mark.parametrize("driver", ["compiled", "reference"])
def test_a_motor_that_wraps_its_angle_moves_the_robot_as_one_that_does_not(
    driver, motor_fmu, tmp_path
):
    """Also where the angle is interpolated over communication steps in which it is wrapped."""
    whole = "theta - 6.283185307179586 * (double)(int64_t)(s->x.theta / 6.283185307179586)"
    wrapped = changed_fmu(tmp_path, "single.c", "s->x.theta;\n", f"s->x.{whole};\n")
    timing = CoSimConfig().timing._replace(rl_step_s=0.05, communication_step_s=1e-3)
    found = []
    for fmu in (motor_fmu, wrapped):
        system = CoSimulation(ONE, fmu, CoSimConfig(timing=timing), driver=driver)
        system.reset(((15, 15),), 0)
        found.append(system.step(np.array([2])).samples)
        system.close()
    plain, other = found
    assert np.abs(plain.theta).max() > 4.0 * np.pi > 2.0 * np.pi > np.abs(other.theta).max()
    np.testing.assert_allclose(other.position, plain.position, rtol=1e-9)
