"""Components with communication steps of their own, against known solutions."""

import itertools
import math

import numpy as np
import pytest

import minirobots as mr
from cosim.base.errors import UserError
from cosim.system.graph import Component, Connection
from cosim.system.system import System
from tests.references.two_masses import CONNECTIONS, error, simulated, two_masses

ALGORITHMS = ("jacobi", "gauss-seidel", "extrapolated")


@pytest.fixture(scope="module")
def masses(tmp_path_factory):
    return two_masses(tmp_path_factory.mktemp("masses"))


def run_masses(masses, until_s, step_s, algorithm, every=1, **own):
    """Return a run of the two masses with steps of their own in s."""
    options = {"step_s": step_s, "algorithm": algorithm, "component_steps": own}
    with System(masses, CONNECTIONS, **options) as system:
        return system.run(until_s, every=every)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_one_rate_has_the_bits_of_no_rates(masses, algorithm):
    found = run_masses(masses, 0.1, 1e-2, algorithm, first=1e-3, second=1e-3)
    expected, _ = simulated(masses, 0.1, 1e-3, algorithm)
    assert found.time_s == pytest.approx(np.linspace(0.0, 0.1, 11))  # rows of the system's step
    for name, values in expected.signals.items():
        assert (found.signals[name] == values[::10]).all()


@pytest.mark.parametrize("steps", [(10, 1), (1, 10), (2, 3)])
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_errors_of_two_rates_have_the_order_of_the_method(masses, algorithm, steps):
    errors = []
    for shortest_s in (1.2e-4, 0.6e-4, 0.3e-4):
        first_s, second_s = (k * shortest_s for k in steps)
        own = {"first": first_s, "second": second_s}
        run = run_masses(masses, 0.9, shortest_s, algorithm, math.lcm(*steps), **own)
        errors.append(error(run))
        assert run.profile["first"].steps == round(0.9 / first_s)
        assert run.profile["second"].steps == round(0.9 / second_s)
    orders = [math.log2(a / b) for a, b in itertools.pairwise(errors)]
    assert orders == pytest.approx([2.0 if algorithm == "extrapolated" else 1.0] * 2, abs=0.1)


def test_outputs_of_a_slow_component_are_passed_on_at_the_end_of_its_step(small):
    components = [Component("slow", small("dahlquist")), Component("fast", small("feedthrough"))]
    links = [Connection("slow.x", "fast.Float64_input")]
    with System(components, links, step_s=0.1, component_steps={"slow": 0.5}) as system:
        run = system.run(2.0)
    k = np.arange(21)
    assert run.signals["slow.x"] == pytest.approx(np.exp(-0.5 * (k // 5)), abs=1e-12)
    assert (run.signals["fast.Float64_output"][1:] == run.signals["slow.x"][:-1]).all()


def test_inputs_over_time_are_those_at_the_steps_of_their_component(small):
    inputs = {"slow.u": ([0.0, 1.0], [0.0, 1.0])}
    for algorithm, value in (("jacobi", 0.0), ("extrapolated", 0.2)):  # at 0 s, mean of 0.4 s
        options = {"algorithm": algorithm, "inputs": inputs, "component_steps": {"slow": 0.4}}
        with System([Component("slow", small("dahlquist"))], step_s=0.1, **options) as system:
            run = system.run(0.4)
        assert run.signals["slow.x"][-1] == pytest.approx(value + (1.0 - value) * math.exp(-0.4))


def test_wish_to_end_counts_at_the_end_of_the_step(small):
    components = [Component("stair", small("stair"), {"last": 3}), Component("x", small("ball"))]
    with System(components, step_s=0.1, component_steps={"stair": 0.5}) as system:
        run = system.run(5.0)
    assert run.ended == "stair asked to end at 2 s"
    assert run.time_s[-1] == pytest.approx(2.0)


def test_loop_of_components_with_the_shortest_step_is_solved(small):
    components = [
        Component("p", small("curve"), {"a": 0.5, "w": 1.0}),
        Component("q", small("curve"), {"a": -3.0, "w": 2.0}),
        Component("x", small("dahlquist")),
    ]
    links = [Connection("p.y", "q.u"), Connection("q.y", "p.u")]
    with System(components, links, step_s=0.1, component_steps={"x": 0.5}) as system:
        run = system.run(1.0)
    assert run.signals["p.y"] == pytest.approx(0.8, abs=1e-9)
    assert run.signals["x.x"][[5, 10]] == pytest.approx(np.exp([-0.5, -1.0]))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"component_steps": {"third": 1e-3}}, "'third'; components are first, second"),
        ({"component_steps": {"first": 0.0}}, "step of first 0: choose one above 0"),
        (
            {"component_steps": {"first": 1.5e-3}},
            "step of first = 0.0015 s is not a whole multiple",
        ),
        ({"component_steps": {"first": 1e-2}, "tolerance": 1e-3}, "leave the tolerance and"),
        ({"component_steps": {"first": 1e-2}, "algorithm": "implicit"}, "another algorithm"),
        ({"component_steps": {"first": 3e-3}}, "a common multiple of all steps = 0.003 s"),
    ],
)
def test_steps_that_do_not_go_together_are_named(masses, options, words):
    with pytest.raises(UserError) as caught, System(masses, CONNECTIONS, **options) as system:
        system.run(0.01)
    assert words in str(caught.value)


def test_loop_across_rates_is_named(small):
    components = [Component(name, small("curve"), {"a": 0.5}) for name in "pq"]
    links = [Connection("p.y", "q.u"), Connection("q.y", "p.u")]
    own = {"component_steps": {"q": 0.5}, "step_s": 0.1}
    with pytest.raises(UserError, match=r"component q .* loop through q\.u; .* --loops explicit"):
        System(components, links, **own)
    with System(components, links, loops="explicit", **own) as system:
        assert system.run(1.0).time_s[-1] == pytest.approx(1.0)


def test_environments_have_steps_of_their_own(masses):
    env = mr.SystemEnv(
        (masses, CONNECTIONS[1:]), actions={"first.F_in": (-1.0, 1.0)}, step_s=1e-3, step=0.01,
        observations=["first.x", "second.x"], reward="first.x", component_steps={"second": 5e-4},
    )  # fmt: skip
    env.reset(seed=0)
    found = [env.step([0.5])[4]["time_s"] for _ in range(3)]
    assert found == pytest.approx([0.01, 0.02, 0.03])
    env.close()
