"""The archives of MiniRobot: valid, from the parameters, and built by others to the same bits."""

import zipfile
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu

from cosim.model.params import TABLE_I, TABLE_II, TIMING, describe
from fmus.compiler import fmi_headers
from fmus.variables import load_table

from ..archive.test_sources import COMPILERS, arguments, run
from .conftest import BODY, REACTIONS, TABLE

OK = 0


@pytest.mark.parametrize("standard", [2, 3])
def test_validator_has_no_complaint(robot_fmus, standard):
    assert validate_fmu(str(robot_fmus[standard])) == []


def test_variables_come_from_the_parameters(robot_fmus):
    records = {**describe(TABLE_I), **describe(TABLE_II), **describe(TIMING)}
    for path in robot_fmus.values():
        description = fmpy.read_model_description(str(path))
        variables = {v.name: v for v in description.modelVariables}
        for name, field in {"mass": "mass_kg", "com_x": "com_x_m", "mu": "mu", "J": "J",
                            "step_size": "dt_s"}.items():  # fmt: skip
            value, quantity = records[field]
            assert float(variables[name].start or 0) == value
            assert variables[name].unit == quantity.unit
        units = {unit.name for unit in description.unitDefinitions}
        assert all(v.unit in units for v in variables.values() if v.type in {"Real", "Float64"})
        assert description.modelExchange is None


def test_its_terminals_fit_those_of_the_motor():
    shaft = load_table().terminals["shaft"]
    for motor in ("motor_D", "motor_E"):
        assert TABLE.terminals[motor].keys() == shaft.keys()
        for name, variable in TABLE.terminals[motor].items():
            assert TABLE[variable].unit == load_table()[shaft[name]].unit
            kinds = {TABLE[variable].causality, load_table()[shaft[name]].causality}
            assert kinds == {"input", "output"}


def test_declared_parameters_of_the_start_are_those_that_matter(robot, fmi):
    plain = robot(fmi)
    names = (*BODY, *REACTIONS)
    assert plain.enter_initialization() == OK
    before = np.array(plain.get(*names))
    declared = {name: TABLE.initial_dependencies(TABLE[name]) for name in names}
    for parameter in TABLE.group("parameter"):
        value = float(parameter.start or 0) * 0.9 or 0.01
        assert plain.set(**{parameter.name: value}) == OK, plain.messages
        changed = np.array(plain.get(*names)) != before
        found = {name for name, differs in zip(names, changed, strict=True) if differs}
        assert found == {name for name in names if parameter.name in declared[name]}
        assert plain.set(**{parameter.name: float(parameter.start or 0)}) == OK


@pytest.mark.long
@pytest.mark.parametrize("compiler", COMPILERS)
def test_others_build_it_to_the_same_bits(robot, robot_fmus, fmi, compiler, tmp_path):
    with zipfile.ZipFile(robot_fmus[fmi]) as archive:
        archive.extractall(tmp_path)
    (tmp_path / "headers").symlink_to(fmi_headers())
    built = tmp_path / "built.so"
    warnings = ["-Wall", "-Wextra", "-Werror", "-Wno-unused-parameter"]
    line = [*COMPILERS[compiler], *warnings, "-shared", "-fPIC", *arguments(tmp_path)]
    run(*line, "-Wl,--no-undefined", "-o", built)
    saved = []
    for made in (robot(fmi), robot(fmi, library=built)):
        made.start(omega_D=900.0, omega_E=-700.0, com_x=0.001, lift_start=1e-5)
        for k in range(200):
            assert made.set(theta_D=0.9 * k, theta_E=1.0 - 0.7 * k) == OK
            assert made.do_step(k * 1e-3, 1e-3) == OK
        saved.append(made.save())
    assert saved[0] == saved[1]


def test_fmpy_simulates_it(robot_fmus, fmi):
    weight = (TABLE_I.mass_kg + 2 * TABLE_II.m) * TABLE_II.g
    result = fmpy.simulate_fmu(
        str(robot_fmus[fmi]), stop_time=0.1, output_interval=1e-3, output=["z", "N_A", "N_B", "N_C"]
    )
    assert sum(result[name][-1] for name in ("N_A", "N_B", "N_C")) == pytest.approx(
        weight, rel=0.02
    )
    assert result["z"][-1] == pytest.approx(TABLE_I.com_height_m, abs=1e-6)


def test_the_page_lists_the_variables(robot_fmus):
    for path in robot_fmus.values():
        with zipfile.ZipFile(path) as archive:
            page = archive.read("documentation/index.html").decode()
            assert Path("documentation/licenses/license.txt").as_posix() in archive.namelist()
        assert "<td>lift_start</td>" in page and "$" not in page
