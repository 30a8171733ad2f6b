"""Algebraic loops and methods of second order, against known solutions."""

import itertools
import math

import numpy as np
import pytest

from cosim.fmi.fmu import FmuError
from cosim.system.graph import Component, Connection, GraphError
from cosim.system.system import System
from tests.references.two_masses import (
    error,
    exact_stiff,
    places,
    simulated,
    stiff_masses,
    two_masses,
)

CIRCLE = [Connection("p.y", "q.u"), Connection("q.y", "p.u")]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("masses")


@pytest.fixture
def curves(small):
    """Components p and q of y = a · f(u) + w."""

    def made(p: dict, q: dict, fmi: int = 3, **differences) -> list[Component]:
        fmu = small("curve", fmi, **differences)
        return [Component("p", fmu, p), Component("q", fmu, q)]

    return made


@pytest.mark.parametrize("fmi", [2, 3])
def test_linear_loop_in_which_values_that_go_around_grow(curves, fmi):
    components = curves({"a": 0.5, "w": 1.0}, {"a": -3.0, "w": 2.0}, fmi)
    with System(components, CIRCLE, step_s=0.1) as system:
        run = system.run(0.5)
    assert run.signals["p.y"] == pytest.approx(0.8, abs=1e-9)
    assert run.signals["q.y"] == pytest.approx(-0.4, abs=1e-9)


def test_nonlinear_loop_of_one_component(small):
    component = Component("a", small("curve"), {"kind": 1})
    with System([component], [Connection("a.y", "a.u")], step_s=0.1) as system:
        run = system.run(0.2)
    assert run.signals["a.y"] == pytest.approx(0.7390851332151607, abs=1e-9)  # u = cos u


@pytest.mark.parametrize("algorithm", ["jacobi", "gauss-seidel", "extrapolated", "implicit"])
def test_solution_follows_what_goes_into_the_loop(curves, small, algorithm):
    components = [Component("x", small("dahlquist")), *curves({"a": 0.2}, {"kind": 2})]
    links = [Connection("x.x", "p.w"), *CIRCLE]
    with System(components, links, step_s=0.01, algorithm=algorithm) as system:
        run = system.run(0.5)  # y = 0.2 y² + x, with x = exp(-t)
    x = np.exp(-run.time_s)
    assert run.signals["x.x"] == pytest.approx(x, abs=1e-12)
    assert run.signals["p.y"] == pytest.approx((1.0 - np.sqrt(1.0 - 0.8 * x)) / 0.4, abs=1e-9)


@pytest.mark.parametrize(
    ("start", "words"),
    [
        ({"w": 1.0}, "the residual is 1 where"),  # u = u + 1
        ({"kind": 2, "w": 1.0}, "the residual is"),  # u = u² + 1
    ],
)
def test_loop_without_a_solution_is_named_with_its_residual(small, start, words):
    component = Component("a", small("curve"), start)
    with pytest.raises(GraphError, match=r"at 0\.00000 s the loop through a\.y -> a\.u") as caught:
        System([component], [Connection("a.y", "a.u")], step_s=0.1)
    assert words in str(caught.value)
    assert "--loops explicit" in str(caught.value)


def test_delay_of_a_step_may_be_accepted(curves):
    components = curves({"a": 0.5, "w": 1.0}, {"a": -1.0, "w": 2.0})
    with System(components, CIRCLE, step_s=0.1, loops="explicit") as system:
        run = system.run(4.0)
    assert abs(run.signals["p.y"][1] - 4.0 / 3.0) > 1e-3
    assert run.signals["p.y"][-1] == pytest.approx(4.0 / 3.0, abs=1e-6)


def test_loops_that_are_none_run_and_keep_their_bits(small):
    runs = []
    for told in (True, False):  # integrators, whose outputs depend on no input at once
        fmu = small("dahlquist", told=told)
        components = [Component("a", fmu, {"x": 2.0}), Component("b", fmu, {"k": 3.0})]
        links = [Connection("a.x", "b.u"), Connection("b.x", "a.u")]
        with System(components, links, step_s=0.01) as system:
            runs.append(system.run(1.0))
    for name, values in runs[0].signals.items():
        assert (runs[1].signals[name] == values).all()


@pytest.mark.parametrize("algorithm", ["extrapolated", "implicit"])
def test_methods_of_second_order_are(folder, algorithm):
    components = two_masses(folder)
    steps = (4e-3, 2e-3, 1e-3)
    errors = [error(simulated(components, 1.0, step, algorithm)[0]) for step in steps]
    orders = [math.log2(a / b) for a, b in itertools.pairwise(errors)]
    assert min(orders) >= 1.95
    assert errors[-1] < 1.1e-4


@pytest.mark.parametrize("algorithm", ["extrapolated", "implicit"])
def test_steps_are_as_long_as_their_errors_let_them_be(folder, algorithm):
    run, system = simulated(two_masses(folder), 1.0, 1e-6, algorithm, 1e-5)
    assert error(run) < 3e-4
    assert system.steps + system.rejected < 500  # 214 176 of first order
    assert system.rejected < 10


def test_implicit_steps_are_stable_where_held_inputs_are_not(folder):
    components, links = stiff_masses(folder)
    runs = {}
    for algorithm in ("jacobi", "implicit"):
        with System(components, links, step_s=1e-3, algorithm=algorithm) as system:
            runs[algorithm] = places(system.run(1.0))
    assert np.abs(runs["jacobi"]).max() > 1e50
    assert np.abs(runs["implicit"]).max() <= 1.0 + 1e-6
    with System(components, links, step_s=1e-5, algorithm="implicit") as system:
        run = system.run(0.1)
    assert np.abs(places(run) - exact_stiff(run.time_s)).max() < 1e-3


def test_implicit_steps_need_states(small):
    components = [Component("a", small("dahlquist", able=False))]
    with pytest.raises(FmuError, match=r"cannot save its state .* choose extrapolated"):
        System(components, algorithm="implicit")
