"""The C right-hand side compared with VibrationMotor.mo, as rumoca and CasADi read it.

rumoca's `casadi-ode` target takes neither events nor algebraic variables nor start values that are
parameters; `flatten` removes them by substitution, which changes no right-hand side.
"""

import re

import numpy as np
import pytest
import rumoca

from cosim.model.params import TABLE_II
from fmus.description import read_description, start_of, variables_of
from fmus.models import read_text
from tests.fmus.starts import motor_starts

INPUTS = ("omega_des", "d", "omega_noise", "V_in")
STATES = ("theta", "omega", "integral")
STEP_S = 1e-3
PARAMETERS = (*TABLE_II._fields, "theta_start", "omega_start")
SPECIFICATION = read_text("VibrationMotor", "VibrationMotor.mo")


def flatten(source: str, closed_loop: bool) -> str:
    """The model with every algebraic variable put in its place, in the wanted loop."""
    source = re.sub(r"//.*", "", source).replace(
        "Boolean closed_loop = true", f"Boolean closed_loop = {str(closed_loop).lower()}"
    )
    source = re.sub(r"\(start = [\w.]+, fixed = true\)", "", source)
    declarations, equations = source.split("\nequation\n")
    right_sides = {}
    for equation in equations.split("end VibrationMotor")[0].split(";"):
        if equation.strip():
            left, right = equation.strip().split(" = ", 1)
            right_sides[left] = f"(noEvent({right}))" if right.startswith("if ") else f"({right})"
    algebraic = [name for name in right_sides if not name.startswith("der(")]
    for name in algebraic:
        declarations = re.sub(rf'\n\s*(output )?Real {name} "[^"]*";', "", declarations)
    names = re.compile(rf"\b({'|'.join(algebraic)})\b")
    lines = []
    for left, right in right_sides.items():
        if left.startswith("der("):
            flat = right
            while names.search(flat):
                flat = names.sub(lambda match: right_sides[match.group()], flat)
            lines.append(f"  {left} = {flat};")
    return declarations + "\nequation\n" + "\n".join(lines) + "\nend VibrationMotor;\n"


@pytest.fixture(scope="module", params=[True, False], ids=["closed-loop", "open-loop"])
def specification(request):
    source = flatten(SPECIFICATION, request.param)
    model = rumoca.Session().loads(source, model="VibrationMotor").to_casadi()
    assert tuple(model.state_names) == STATES
    assert tuple(model.input_names) == INPUTS
    return request.param, model


def test_specification_is_valid_modelica_with_the_same_names_and_defaults():
    model = rumoca.Session().loads(SPECIFICATION, model="VibrationMotor")
    variables = variables_of(read_description("VibrationMotor"))
    assert [v.get("name") for v in variables if v.get("causality") == "input"] == list(INPUTS)
    for variable in variables:
        name, causality = variable.attrib["name"], variable.get("causality")
        if causality == "output":
            assert re.search(rf"output Real {name}\b", SPECIFICATION)
        if name in PARAMETERS:
            assert model.parameters[name].value == start_of(variable), name
            description = re.escape(variable.attrib["description"])
            assert re.search(rf"Real {name} = [^\"]*\"{description}", SPECIFICATION), name


def random_points(count: int):
    """Parameters about those of Table II, states and inputs over the whole range of use."""
    generator = np.random.default_rng(13)
    defaults = {name: motor_starts()[name] for name in PARAMETERS}
    for k in range(count):
        parameters = {n: v * generator.uniform(0.5, 2.0) for n, v in defaults.items()}
        speed = 0.0 if k % 5 == 0 else generator.uniform(-6000.0, 6000.0)
        states = [generator.uniform(-10.0, 1e4), speed, generator.uniform(-100.0, 100.0)]
        inputs = [generator.uniform(-6000.0, 6000.0), generator.uniform(-3e-5, 3e-5)]
        inputs += [generator.uniform(-50.0, 50.0), generator.uniform(-4.0, 4.0)]
        if k % 3 == 0:  # near the speed that is asked for: within the limits
            inputs[0] = speed + generator.uniform(-100.0, 100.0)
            states[2] = generator.uniform(-20.0, 20.0)
        yield parameters, states, inputs


def test_right_hand_side_is_that_of_the_specification(specification, instance):
    """The rate of the integral is seen in one internal step of semi-implicit Euler."""
    closed_loop, model = specification
    limited = stuck = 0
    for parameters, states, inputs in random_points(300):
        values = parameters | dict(zip(INPUTS, inputs, strict=True))
        motor = instance(3).start(closed_loop=closed_loop, step_size=STEP_S, **values)
        motor.place(**dict(zip(STATES, states, strict=True)))
        ordered = [parameters.get(name, float(closed_loop)) for name in model.parameter_names]
        rates = np.array(model.rhs(0.0, states, inputs, ordered))[:, 0]
        limited += abs(motor.get("u")[0]) > values["V_s_max"]
        stuck += states[1] == 0.0 and rates[1] == 0.0
        found = motor.get("omega", "omega_dot")
        assert motor.do_step(0.0, STEP_S) == 0, motor.messages
        found.append((motor.get("integral")[0] - states[2]) / STEP_S)
        # Both round: relative to the largest term, which may cancel, errors of some 1e-16.
        terms = parameters["V_s_max"] * parameters["K_T"] / parameters["R"] / parameters["J"]
        assert found == pytest.approx(rates, rel=1e-12, abs=1e-12 * terms)
        motor.free()
    assert limited > 30, limited
    assert stuck > 3, stuck
