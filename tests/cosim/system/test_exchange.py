"""FMUs for Model Exchange: their equations, events, ends and rollbacks, alone and coupled."""

import itertools
import math
import os
import signal
import threading

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import minirobots as mr
from cosim.fmi.fmu import Fmu, FmuError
from cosim.system.graph import Component, Connection, GraphError
from cosim.system.ssp.reader import read_system
from cosim.system.system import System
from tests.references.small import small_fmu
from tests.references.two_masses import COUPLING, SPRINGS, error, simulated

ONLY, BOTH = ("ModelExchange",), ("CoSimulation", "ModelExchange")
GRAVITY, RESTITUTION = 9.81, 0.7


def simulate(fmu, until_s, step_s, **options):
    """Return a run of one component, which is named a."""
    start = options.pop("start", {})
    with System([Component("a", fmu, start)], step_s=step_s, **options) as system:
        return system.run(until_s)


def bounces(count):
    """Return times in s at which the ball from 1 m is on the floor, and its speeds after them."""
    speeds = math.sqrt(2.0 * GRAVITY) * RESTITUTION ** np.arange(count + 1)
    times_s = math.sqrt(2.0 / GRAVITY) + np.cumsum([0.0, *(2.0 * speeds[1:-1] / GRAVITY)])
    return times_s, speeds[1:]


@pytest.mark.parametrize("fmi", [2, 3])
def test_equations_are_integrated_within_the_tolerance(small, fmi):
    fmu = small("dahlquist", fmi, interfaces=ONLY)
    errors = []
    for tolerance in (1e-5, 1e-8):
        run = simulate(fmu, 5.0, 0.1, solver_tolerance=tolerance)
        errors.append(np.abs(run.signals["a.x"] - np.exp(-run.time_s)).max())
    assert 1e-7 < errors[0] < 1e-4
    assert errors[1] < 1e-7
    run = simulate(small("van_der_pol", fmi, interfaces=ONLY), 20.0, 0.01)
    expected = solve_ivp(
        lambda _, x: [x[1], (1.0 - x[0] ** 2) * x[1] - x[0]], (0.0, 20.0), [2.0, 0.0],
        "DOP853", run.time_s, rtol=1e-12, atol=1e-12,
    ).y  # fmt: skip
    assert run.signals["a.x0"] == pytest.approx(expected[0], abs=5e-6)
    assert run.signals["a.x1"] == pytest.approx(expected[1], abs=5e-6)


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("step_s", [0.01, 0.5])
def test_ball_bounces_at_the_right_times(small, fmi, step_s):
    run = simulate(small("ball", fmi, interfaces=ONLY), 2.0, step_s)
    times_s, speeds = bounces(8)
    for time_s, h, v in zip(run.time_s, run.signals["a.h"], run.signals["a.v"], strict=True):
        last = np.searchsorted(times_s, time_s) - 1
        since_s = time_s - times_s[last] if last >= 0 else time_s
        v_0, h_0 = (speeds[last], 0.0) if last >= 0 else (0.0, 1.0)
        assert h == pytest.approx(h_0 + v_0 * since_s - 0.5 * GRAVITY * since_s**2, abs=1e-6)
        assert v == pytest.approx(v_0 - GRAVITY * since_s, abs=1e-6)
    assert (times_s < 2.0).sum() == 4


@pytest.mark.parametrize("fmi", [2, 3])
def test_events_in_time_and_of_steps_happen_and_fmus_may_end_the_run(small, fmi):
    run = simulate(small("stair", fmi, interfaces=ONLY), 9.0, 0.3, start={"last": 4})
    assert run.ended == "a asked to end at 3 s"
    expected = [1 + math.floor(time_s + 1e-9) for time_s in run.time_s[:-1]]
    assert run.signals["a.counter"].tolist() == [*expected, 4]
    fmu = small("van_der_pol", fmi, interfaces=ONLY)
    run = simulate(fmu, 20.0, 0.01)
    signs = run.signals["a.x0"] < 0.0
    assert run.signals["a.turns"][-1] == (np.diff(signs) != 0).sum() == 6
    run = simulate(fmu, 20.0, 0.01, start={"ends_at": 1.234})
    assert run.ended == "a asked to end at 1.24 s"
    run = simulate(small("restless", fmi, interfaces=ONLY), 1.0, 0.1, start={"mood": 2})
    assert run.ended == "a asked to end at the start"


@pytest.mark.parametrize("algorithm", ["jacobi", "gauss-seidel", "extrapolated", "implicit"])
@pytest.mark.parametrize("tolerance", [None, 1e-3])
def test_components_of_both_kinds_are_coupled_by_every_algorithm(small, algorithm, tolerance):
    first = {"k": SPRINGS[0], "x": 1.0}
    second = {"k": SPRINGS[1], "k_c": COUPLING, "x": 0.0}
    errors, rejected = [], []
    usual, exchanged = [
        (f, small("oscillator", f, interfaces=i)) for i in (BOTH, ONLY) for f in (2, 3)
    ][::3]
    for (_, a), (_, b) in itertools.product((usual, exchanged), repeat=2):
        components = [Component("first", a, first), Component("second", b, second)]
        step_s = 1e-6 if tolerance else 1e-3
        run, system = simulated(components, 0.5, step_s, algorithm, tolerance)
        errors.append(error(run))
        rejected.append(system.rejected)
    assert errors == pytest.approx([errors[0]] * 4, rel=0.15)
    assert tolerance is None or algorithm not in ("extrapolated", "implicit") or min(rejected) > 0


@pytest.mark.parametrize("source", [2, 3])
def test_discrete_inputs_are_set_in_event_mode(small, source):
    start = {"Float64_input": 2.5, "Int32_input": -7, "Boolean_input": True}
    fmus = [small("feedthrough", fmi, interfaces=ONLY) for fmi in (source, 5 - source)]
    components = [Component("a", fmus[0], start), Component("b", fmus[1])]
    kinds = ["Float64", "Int32", "Boolean"]
    links = [Connection(f"a.{kind}_output", f"b.{kind}_input") for kind in kinds]
    steps = {"a.Int32_input": ([0.0, 0.35], [-7, 9])}
    with System(components, links, step_s=0.1, inputs=steps) as system:
        run = system.run(1.0)
    assert run.signals["b.Int32_output"].tolist() == [-7] * 6 + [9] * 5
    assert (run.signals["b.Float64_output"] == 2.5).all()
    assert run.signals["b.Boolean_output"].all()


def test_inputs_and_bounces_of_coupled_components_meet(small):
    ball = Component("ball", small("ball", 2, interfaces=ONLY))
    filter_ = Component("filter", small("dahlquist", 3), {"x": 0.0, "k": 1e-9})  # an integral
    with System(
        [ball, filter_], [Connection("ball.v", "filter.u")], step_s=1e-3, algorithm="gauss-seidel"
    ) as system:
        run = system.run(1.0)
    assert run.signals["filter.x"] + 1.0 == pytest.approx(run.signals["ball.h"], abs=0.02)


@pytest.mark.parametrize("fmi", [2, 3])
def test_failures_are_named_and_interrupts_arrive(small, fmi):
    fmu = small("dahlquist", fmi, interfaces=ONLY)
    with pytest.raises(FmuError, match=r"instance a, at 0\.50000 s failed .*Derivatives failed with"
                       r" status 3 \(error\): cannot go on"):  # fmt: skip
        simulate(fmu, 1.0, 0.1, start={"fails_at": 0.55})
    with pytest.raises(FmuError, match=r"at 0\.00000 s .*10000 updates"):
        simulate(small("restless", fmi, interfaces=ONLY), 1.0, 0.1, start={"mood": 1})
    with pytest.raises(
        FmuError, match=r"(cannot integrate it|the solver makes no progress at 0\.07)"
    ):
        simulate(fmu, 2.0, 1.0, start={"k": -1e4})

    timer = threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        simulate(fmu, 1e6, 0.1)
    timer.join()


@pytest.mark.parametrize("fmi", [2, 3])
def test_environment_goes_back_with_the_same_bits(small, fmi, replayed):
    fmu = small("dahlquist", fmi, interfaces=ONLY)
    components = [Component("a", fmu), Component("b", small("stair", fmi, interfaces=ONLY))]
    env = mr.SystemEnv(
        (components, []), actions={"a.u": (-1.0, 1.0)}, observations=["a.x", "b.counter"],
        reward="a.x", step=0.5, step_s=0.1,
    )  # fmt: skip
    first = replayed(env)
    assert first[:, 1].tolist() == [1, 2, 2, 3, 3, 4, 4, 5, 5, 6]


SSD = """<SystemStructureDescription xmlns="http://ssp-standard.org/SSP1/SystemStructureDescription"
version="1.0" name="s"><System name="s"><Elements>
<Component name="a" source="{}" implementation="{}"/></Elements></System>
</SystemStructureDescription>"""


@pytest.mark.parametrize("fmi", [2, 3])
def test_interface_is_chosen_by_the_file(tmp_path, fmi):
    for interfaces in (("CoSimulation",), ONLY, BOTH):
        name = "+".join(interfaces)
        small_fmu(tmp_path / f"{name}.fmu", "dahlquist", fmi, interfaces=interfaces)
        for wanted in ("any", *BOTH):
            path = tmp_path / f"{name} {wanted}.ssd"
            path.write_text(SSD.format(f"{name}.fmu", wanted))
            if wanted in ("any", *interfaces):
                (component,) = read_system(path).components
                assert isinstance(component.fmu, Fmu)
                exchange = wanted == "ModelExchange" or interfaces == ONLY
                assert component.fmu.exchange == exchange
                assert simulate(component.fmu, 1.0, 0.1).time_s[-1] == pytest.approx(1.0)
            else:
                with pytest.raises(FmuError, match=r"component a: FMU .* has no .* interface"):
                    read_system(path)
    path = tmp_path / "scheduled.ssd"
    path.write_text(SSD.format("CoSimulation.fmu", "ScheduledExecution"))
    with pytest.raises(GraphError, match=r"is for ScheduledExecution; choose from any, Co"):
        read_system(path)
