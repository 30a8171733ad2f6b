"""Clocks that tick in time, with an FMU that refuses what the standard forbids, at known times."""

import itertools
import math

import numpy as np
import pytest

import minirobots as mr
from cosim.base.errors import UserError
from cosim.fmi.fmu import FmuError
from cosim.system.graph import Component, Connection, GraphError
from cosim.system.system import System
from tests.cosim.system.test_refusals import changed
from tests.references.two_masses import CONNECTIONS, error, two_masses

ALGORITHMS = ("jacobi", "gauss-seidel", "extrapolated", "implicit")
INTERFACES = (("CoSimulation",), ("ModelExchange",))
EVERY_3_MS = 'intervalVariability="constant" intervalDecimal="0.003"'
EVERY_5_MS = 'intervalVariability="constant" intervalDecimal="0.005"'
KINDS = {1: "changing", 2: "countdown", 3: "countdown", 5: "tunable", 6: "changing", 7: "changing"}


@pytest.fixture
def ticker(small, tmp_path):
    """A ticker whose clock a is of some kind, by default constant, of an interval in s, or told."""

    def make(clock, interfaces=INTERFACES[0], **start):
        fmu = small("ticker", interfaces=interfaces)
        if isinstance(clock, float):
            clock = str(clock).replace("nan", "NaN").replace("inf", "INF")
            clock = f'intervalVariability="constant" intervalDecimal="{clock}"'
        return Component("a", changed(fmu, tmp_path, EVERY_3_MS, clock), start)

    return make


def told(kind, **start):
    """Return a clock whose interval the FMU tells, and start values of it."""
    return f'intervalVariability="{KINDS[kind]}"', {"kind": kind, **start}


def simulate(component, until_s, step_s, links=(), others=(), every=1, **options):
    with System([component, *others], links, step_s=step_s, **options) as system:
        return system.run(until_s, every=every)


def ticks_of(run, name="a"):
    """Return times in s of ticks that are seen at the ends of steps."""
    return np.unique(run.signals[f"{name}.last_s"])


@pytest.mark.parametrize("interfaces", INTERFACES)
@pytest.mark.parametrize("step_s", [1e-3, 2e-3, 7e-3, 0.1])
def test_clocks_meet_without_drift(small, interfaces, step_s):
    fmu = small("ticker", interfaces=interfaces)
    last = {}
    until_s = 2.1 if interfaces == INTERFACES[1] else 6.3
    for other in ((), (Component("b", fmu),)):
        run = simulate(Component("a", fmu), until_s, step_s, others=other)
        n = np.rint(run.time_s / step_s) * round(1e3 * step_s)  # in ms
        for name in ("a", "b")[: 1 + len(other)]:
            assert (run.signals[f"{name}.ticks_a"] == n // 3 + 1).all()
            assert (run.signals[f"{name}.ticks_b"] == n // 5 + 1).all()
            assert (run.signals[f"{name}.both"] == n // 15 + 1).all()
        last[len(other)] = run.signals["a.last_s"][-1]
    assert list(last.values()) == pytest.approx([until_s] * 2, abs=1e-12)


def closed_loop(interval_s, count, kp, ki):
    """Return values of x' = u - x after each tick, and of u, from equations of differences."""
    x, integral, found = 1.0, 0.0, []
    for _ in range(count):
        e = 0.5 - x
        integral += ki * e
        u = kp * e + integral
        found.append((x, u))
        x = u + (x - u) * math.exp(-interval_s)
    return np.array(found).T


@pytest.mark.parametrize("algorithm", ALGORITHMS)
@pytest.mark.parametrize(("step_s", "tolerance"), [(0.05, None), (0.03, None), (1e-3, 1e-3)])
@pytest.mark.parametrize("interfaces", INTERFACES)
def test_sampled_controller_is_that_of_discrete_time(
    ticker, small, algorithm, step_s, tolerance, interfaces
):
    start = {"r": 0.5, "kp": 2.0, "ki": 0.3}
    links = [Connection("plant.x", "a.y"), Connection("a.u", "plant.u")]
    plant = Component("plant", small("dahlquist"))
    controller = ticker(0.05, interfaces, **start)
    options = {"algorithm": algorithm, "tolerance": tolerance}
    run = simulate(controller, 3.0, step_s, links, [plant], **options)
    x, u = closed_loop(0.05, 61, 2.0, 0.3)
    k = np.rint(run.time_s / 0.05).astype(int)
    at = np.abs(run.time_s - 0.05 * k) < 1e-9
    assert at.sum() >= 20
    assert np.abs(run.signals["plant.x"][at] - x[k[at]]).max() < 1e-12
    assert np.abs(run.signals["a.u"][at] - u[k[at]]).max() < 1e-12


@pytest.mark.parametrize("interfaces", INTERFACES)
@pytest.mark.parametrize("step_s", [0.1, 0.37])
@pytest.mark.parametrize(
    ("kind", "intervals"),
    [
        (1, lambda n: 0.1 * n),
        (2, lambda n: 0.1 * math.sqrt(n)),
        (5, lambda n: 0.1 if n < 3 else 0.05),
    ],
)
def test_intervals_change_at_ticks(ticker, interfaces, step_s, kind, intervals):
    clock, start = told(kind, shift=0.02)
    run = simulate(
        ticker(clock, interfaces, **start), 3.7, step_s, record=["a.last_s", "a.ticks_a"]
    )
    begun = 0.02 if kind == 5 else 0.1
    times = [begun, *(begun + np.cumsum([intervals(n) for n in range(1, 100)]))]
    expected = [max([0.0, *(t for t in times if t <= now + 1e-9)]) for now in run.time_s]
    assert run.signals["a.last_s"] == pytest.approx(expected, abs=1e-12)
    assert run.signals["a.ticks_a"][-1] == sum(t <= 3.7 + 1e-9 for t in times)


@pytest.mark.parametrize("interfaces", INTERFACES)
@pytest.mark.parametrize("cause", ["input", "event"])
def test_countdown_follows_an_event_in_a_step(ticker, interfaces, cause):
    clock, start = told(3, interval=0.123)
    if cause == "event":
        start["event_s"] = 0.2525
    inputs = {"a.go": ([0.0, 0.4, 0.8], [0, 1, 2])} if cause == "input" else {}
    run = simulate(ticker(clock, interfaces, **start), 2.0, 0.1, inputs=inputs)
    expected = [0.0, 0.523, 0.923] if cause == "input" else [0.0, 0.3755]
    assert ticks_of(run) == pytest.approx(expected, abs=1e-9)
    if cause == "input":  # is set in the Event Mode of clock b, at the same time
        return
    start["interval"] = 0.002  # before the end of the step with the event
    with pytest.raises(
        UserError, match=r"was to tick within the step that ends at .* shorter step"
    ):
        simulate(ticker(clock, interfaces, **start), 2.0, 0.1, inputs=inputs)


def test_fractions_are_exact(ticker):
    clock = 'intervalVariability="fixed" supportsFraction="true"'
    run = simulate(ticker(clock, interval=1 / 3), 30.0, 0.5)
    assert run.signals["a.ticks_a"][-1] == 91
    assert run.signals["a.last_s"][-1] == 30.0


@pytest.mark.parametrize("order", [1, -1])
def test_values_pass_through_components_that_tick_together(ticker, small, order):
    first = ticker(0.2, kp=-1.0)  # u = y
    second, third = (first._replace(name=name) for name in "bc")
    third = third._replace(fmu=ticker(0.4).fmu)
    links = [Connection("source.x", "a.y"), Connection("a.u", "b.y"), Connection("b.u", "c.y")]
    components = [Component("source", small("dahlquist")), first, second, third][::order]
    with System(components, links, step_s=0.1) as system:
        run = system.run(1.0)
    k = np.arange(11)
    for name, every in (("a", 2), ("b", 2), ("c", 4)):
        assert run.signals[f"{name}.u"] == pytest.approx(np.exp(-0.1 * (k - k % every)))
    links.append(Connection("c.u", "source.u", offset=1.0))
    assert simulate(components[0], 1.0, 0.1, links, components[1:]).time_s[-1] == 1.0


def test_clocks_tick_again_at_one_time(ticker):
    clock, start = told(6)
    run = simulate(ticker(clock, **start), 1.0, 0.1)
    assert run.signals["a.ticks_a"].tolist() == [0, *range(3, 33, 3)]
    clock, start = told(7)
    with pytest.raises(GraphError, match=r"at 0\.1 s clocks tick more than 1000 times"):
        simulate(ticker(clock, **start), 1.0, 0.1)


@pytest.mark.parametrize("algorithm", ["jacobi", "extrapolated", "implicit"])
def test_steps_in_parts_keep_the_order_of_the_method(ticker, tmp_path, algorithm):
    masses = two_masses(tmp_path)
    errors = [
        error(simulate(masses[0], 0.9, step_s, CONNECTIONS, [masses[1], ticker(0.0731)],
                       algorithm=algorithm))
        for step_s in (2e-3, 1e-3, 5e-4)
    ]  # fmt: skip
    orders = [math.log2(a / b) for a, b in itertools.pairwise(errors)]
    assert orders[-1] == pytest.approx(1.0 if algorithm == "jacobi" else 2.0, abs=0.05)


def test_environment_goes_back_to_the_same_ticks(ticker, small, replayed):
    clock, start = told(2, r=0.5, kp=1.0)
    links = [Connection("plant.x", "a.y")]
    env = mr.SystemEnv(
        ([ticker(clock, **start), Component("plant", small("dahlquist"))], links),
        actions={"plant.u": (-1.0, 1.0)}, observations=["a.u", "a.now_s"], reward="a.u",
        step=0.3, step_s=0.1,
    )  # fmt: skip
    first = replayed(env)
    assert len(np.unique(first[:, 1])) == 9


def test_what_clocks_cannot_do_is_named(ticker, small, tmp_path):
    refused = {
        "leave out steps of components": {"component_steps": {"a": 0.05}},
        r"clock 'a' \(countdown\) .* leave the tolerance out": {"tolerance": 1e-3},
        "another algorithm than implicit": {"algorithm": "implicit"},
    }
    clock, start = told(2)
    for words, options in refused.items():
        with pytest.raises(GraphError, match=words):
            simulate(ticker(clock, **start), 1.0, 0.1, **options)
    for clock, start, words in (
        (0.0, {}, r"clock 'a' \(constant\) has a interval of 0 s"),
        (
            math.nan,
            {},
            r"clock 'a' \(constant\) declares an interval or a shift that is not a number",
        ),
        (math.inf, {}, "that is not a number"),
        (
            'intervalVariability="constant" intervalCounter="3" resolution="0"',
            {},
            "is not a number",
        ),
        (*told(1, interval=-1.0), "has a interval of -1 s"),
        (*told(5, shift=-1.0), "has a shift of -1 s"),
        (*told(5, interval=math.nan), "is out of range"),
    ):
        with pytest.raises(GraphError, match=words):
            simulate(ticker(clock, **start), 1.0, 0.1)
    fixed = small("dahlquist", able=False)
    with pytest.raises(FmuError, match=r"step at 0\.005 s, but component x cannot vary its step"):
        simulate(ticker(0.0075), 1.0, 5e-3, others=[Component("x", fixed)])
    loop = [Connection("a.u", "a.y", 2.0)]
    with pytest.raises(
        GraphError, match=r"at 0 s values that clocks \(a\.a, a\.b\) .* settle after 1000"
    ):
        simulate(ticker(0.15, kp=-1.0, r=1.0), 1.0, 0.1, loop)
    path = changed(small("ticker"), tmp_path, 'hasEventMode="true"', 'hasEventMode="false"')
    with pytest.raises(GraphError, match=r"component a: .* clock 'a' .* no Event Mode"):
        simulate(Component("a", path), 1.0, 0.1)
    triggered = ticker('intervalVariability="triggered"')
    assert "a.u" not in simulate(triggered, 1.0, 0.1).signals
    with pytest.raises(GraphError, match="'u' is tied to clocks that do not tick in time"):
        simulate(triggered, 1.0, 0.1, record=["a.u"])
