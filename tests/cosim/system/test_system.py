"""Systems that run: orders, bits, types, arrays, events, ends, and lives."""

import gc
import hashlib
import itertools
import math
import os
import subprocess
import sys
import weakref
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from pyarrow import csv, parquet

from cosim.coupling.assembly import Motors
from cosim.coupling.fmu import MotorFmu
from cosim.fmi.fmu import Fmu, FmuError
from cosim.model.config import CoSimConfig
from cosim.model.params import TABLE_II
from cosim.system.graph import Component, Connection, GraphError
from cosim.system.instance import Instance
from cosim.system.result import write_run
from cosim.system.system import System
from tests.references.two_masses import (
    CONNECTIONS,
    PLACES,
    PythonLoop,
    error,
    simulated,
    two_masses,
)

ALGORITHMS = ("jacobi", "gauss-seidel")
DIGEST = """
import sys
from pathlib import Path
from tests.references.two_masses import simulated, two_masses
import hashlib
run, _ = simulated(two_masses(Path(sys.argv[1]), (2, 3)), 0.2, 1e-5, "jacobi", 1e-3)
print(hashlib.sha256(b"".join(v.tobytes() for v in run.signals.values())).hexdigest())
"""


@pytest.fixture(scope="module")
def masses(tmp_path_factory):
    folder = tmp_path_factory.mktemp("masses")
    return {pair: two_masses(folder, pair) for pair in ((2, 2), (2, 3), (3, 2), (3, 3))}


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_errors_of_fixed_steps_are_of_first_order(masses, algorithm):
    errors = [
        error(simulated(masses[3, 3], 1.0, step, algorithm)[0]) for step in (2e-4, 1e-4, 5e-5)
    ]
    orders = [math.log2(a / b) for a, b in itertools.pairwise(errors)]
    assert orders == pytest.approx([1.0, 1.0], abs=0.02)
    assert errors[-1] < (4e-3 if algorithm == "jacobi" else 2e-3)


@pytest.mark.long
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_errors_of_varied_steps_follow_the_tolerance(masses, algorithm):
    runs = [simulated(masses[3, 3], 1.0, 1e-6, algorithm, tol) for tol in (1e-2, 1e-4)]
    errors = [error(run) for run, _ in runs]
    order = math.log10(errors[0] / errors[1]) / 2.0
    assert order == pytest.approx(0.5, abs=0.1)  # the error of a step is of second order
    (_, coarse), (run, fine) = runs
    assert 0 < coarse.steps < fine.steps
    assert all(share.rollbacks == fine.rejected for share in run.profile.values())
    assert all(share.steps > 2 * fine.rejected for share in run.profile.values())
    assert (np.diff(run.time_s) > 0.0).all()
    assert run.time_s[-1] == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_standards_mix_with_the_same_bits(masses, algorithm):
    runs = [simulated(components, 0.1, 1e-4, algorithm)[0] for components in masses.values()]
    for run in runs[1:]:
        for name, values in runs[0].signals.items():
            assert (run.signals[name] == values).all()


def test_bits_are_those_of_a_loop_in_python(masses):
    loop = PythonLoop(masses[3, 3])
    loop.run(300, 1e-4)
    run, _ = simulated(masses[3, 3], 0.03, 1e-4, "jacobi")
    assert [each[0] for each in loop.outputs] == [run.signals[name][-1] for name in PLACES]
    loop.close()


def test_bits_do_not_depend_on_threads_or_processes(masses, tmp_path):
    def digest(_):
        run, _ = simulated(masses[2, 3], 0.2, 1e-5, "jacobi", 1e-3)
        return hashlib.sha256(b"".join(v.tobytes() for v in run.signals.values())).hexdigest()

    with ThreadPoolExecutor(4) as pool:
        found = set(pool.map(digest, range(8)))
    done = subprocess.run(
        [sys.executable, "-c", DIGEST, str(tmp_path)], capture_output=True, text=True, check=False
    )
    assert found == {done.stdout.strip()}, done.stderr


def test_motors_have_the_bits_that_the_robots_master_gives_them(motor_fmu):
    config, steps = CoSimConfig(), 3000
    motors = Motors(MotorFmu(motor_fmu), config, 1)
    motors.restart([0], [(TABLE_II, TABLE_II)])
    inputs = np.array([[700.0], [-500.0], [0.0], [0.0], [0.0], [0.0]])
    dt, outputs = config.timing.dt_s, np.empty((6, 1))
    motors.set_inputs(inputs, dt)
    expected = []
    for _ in range(steps):
        motors.step(1, dt)
        motors.get_outputs(outputs, dt)
        expected.append(outputs[:, 0].copy())
    motors.close()
    speeds = zip("DE", inputs[:2, 0], strict=True)
    components = [Component(name, motor_fmu, {"omega_des": speed}) for name, speed in speeds]
    names = [f"{motor}.{v}" for v in ("theta", "omega", "omega_dot") for motor in "DE"]
    with System(components, step_s=dt, record=names) as system:
        run = system.run(steps * dt)
    found = np.array([run.signals[name][1:] for name in names]).T
    assert (found == np.array(expected)).all()
    assert abs(found[-1, 2]) > 100.0


def test_going_on_gives_the_same_bits_and_fewer_rows_where_wanted(masses):
    whole, _ = simulated(masses[3, 3], 0.02, 1e-3, "gauss-seidel")
    with System(masses[3, 3], CONNECTIONS, algorithm="gauss-seidel") as system:
        first, second = system.run(0.01, every=5), system.run(0.02, every=3)
    assert first.time_s == pytest.approx([0.0, 0.005, 0.01])
    assert second.time_s == pytest.approx([0.01, 0.012, 0.015, 0.018, 0.02])
    assert (second.signals["first.x"] == whole.signals["first.x"][[10, 12, 15, 18, 20]]).all()


@pytest.mark.parametrize("source", [2, 3])
@pytest.mark.parametrize("target", [2, 3])
def test_values_of_every_type_are_passed_on(small, source, target):
    start = {
        "Float64_input": 2.5, "Int32_input": -7, "Boolean_input": True, "Enumeration_input": "two",
        "String_input": "grüße, x",
    }  # fmt: skip
    if source == target == 3:
        start |= {
            "Float32_input": 0.1, "Int8_input": -128, "UInt8_input": 255, "Int16_input": -32768,
            "UInt16_input": 65535, "UInt32_input": 2**32 - 1, "Int64_input": -(2**63),
            "UInt64_input": 2**63 - 1,
        }  # fmt: skip
    kinds = [name.removesuffix("_input") for name in start]
    components = [
        Component("a", small("feedthrough", source), start),
        Component("b", small("feedthrough", target)),
    ]
    connections = [Connection(f"a.{kind}_output", f"b.{kind}_input") for kind in kinds]
    outputs = [f"b.{kind}_output" for kind in kinds]
    with System(components, connections, step_s=0.1, record=outputs) as system:
        run = system.run(0.3)
    for kind, value in zip(kinds, start.values(), strict=True):
        expected = {"Enumeration": 2, "Float32": np.float32(0.1)}.get(kind, value)
        assert (run.signals[f"b.{kind}_output"] == expected).all(), kind
    assert run.signals["b.Boolean_output"].dtype == bool


@pytest.mark.parametrize(("source", "target"), [(2, 3), (3, 2), (3, 3)])
@pytest.mark.parametrize("algorithm", [*ALGORITHMS, "implicit"])
def test_calculated_parameters_set_parameters_at_the_start(small, source, target, algorithm):
    components = [
        Component("c", small("dahlquist", target), {"k": 7.0}),  # before its source
        Component("a", small("dahlquist", source), {"k": 0.25}),
        Component("b", small("dahlquist", target)),
    ]
    links = [
        Connection("a.double_k", "b.k", 2.0), Connection("b.double_k", "c.k"),
        Connection("a.double_k", "c.u"),
    ]  # fmt: skip
    record = ["b.x", "c.x", "b.double_k", "c.double_k"]
    with System(components, links, step_s=0.1, algorithm=algorithm, record=record) as system:
        run = system.run(1.0)
    assert run.signals["b.double_k"].tolist() == [2.0] * 11
    assert run.signals["c.double_k"].tolist() == [4.0] * 11
    assert run.signals["b.x"] == pytest.approx(np.exp(-run.time_s))
    assert run.signals["c.x"] == pytest.approx(0.25 + 0.75 * np.exp(-2.0 * run.time_s))


def test_texts_that_change_are_passed_on_and_written(small, tmp_path):
    stair = Component("stair", small("namer"))
    components = [stair, Component("b", small("feedthrough"))]
    links = [Connection("stair.name", "b.String_input")]
    record = ["stair.name", "b.String_output"]
    with System(components, links, step_s=0.5, record=record) as system:
        run = system.run(2.0)
    assert run.signals["stair.name"].tolist() == ["", "step 0", "step 1", "step 1", "step 2"]
    assert run.signals["b.String_output"].tolist() == ["", "", "step 0", "step 1", "step 1"]
    for suffix, read in ((".csv", csv.read_csv), (".parquet", parquet.read_table)):
        write_run(tmp_path / f"run{suffix}", run)
        table = read(tmp_path / f"run{suffix}")
        assert table["stair.name"].to_pylist()[1:] == run.signals["stair.name"].tolist()[1:]
    with (
        System(components, links, record=record) as system,
        pytest.raises(GraphError, match=r"stair\.name is an array or text; choose numbers"),
    ):
        system.reader(["stair.name"])


@pytest.mark.parametrize(
    ("source", "target"),
    [("Int8", "Int16"), ("UInt8", "Int32"), ("Int32", "Float64"), ("UInt16", "Float32"),
     ("Float32", "Float64"), ("Int16", "Int64"), ("UInt32", "Int64"), ("UInt8", "UInt64")],
)  # fmt: skip
def test_values_that_fit_are_converted(small, source, target):
    value = 0.1 if source == "Float32" else 200 if source[0] == "U" else -100
    through = small("feedthrough")
    components = [Component("a", through, {f"{source}_input": value}), Component("b", through)]
    connections = [Connection(f"a.{source}_output", f"b.{target}_input")]
    with System(components, connections, step_s=0.1) as system:
        found = system.run(0.1).signals[f"b.{target}_output"]
    assert (found == (np.float32(value) if source == "Float32" else value)).all()


def test_units_are_converted_and_transformations_applied(small):
    metres, millimetres = small("oscillator"), small("oscillator", units={"x_in": "mm"})
    held = {"k": 1e-9, "x": 0.25, "m": 1e9}
    components = [Component("a", metres, held), Component("b", millimetres, {"k_c": 1.0, "x": 0})]
    with System(components, [Connection("a.x", "b.x_in", 2.0, 1.0)], step_s=1e-9) as system:
        run = system.run(1e-9)
    assert run.signals["b.F"][0] == pytest.approx(-501.0)  # −k_c (2 · 250 mm + 1 mm)


def test_initial_outputs_pass_through_components_in_their_order(small):
    through = small("feedthrough")
    names = ["d", "c", "b", "a"]  # against the direction of values
    components = [Component(n, through, {"Int32_input": 5} if n == "a" else {}) for n in names]
    connections = [
        Connection(f"{a}.Int32_output", f"{b}.Int32_input") for a, b in ("ab", "bc", "cd")
    ]
    with System(components, connections, step_s=0.1) as system:
        run = system.run(0.1)
    assert [run.signals[f"{n}.Int32_output"][0] for n in "abcd"] == [5, 5, 5, 5]


def test_arrays_have_the_size_that_their_parameter_says(small):
    arrays = small("array")
    components = [
        Component("a", arrays, {"n": 4, "u": [1.0, 2.0, 3.0, 4.0]}),
        Component("b", arrays, {"n": "4", "u": "0 0 0 0"}),
    ]
    with System(components, [Connection("a.y", "b.u")], step_s=0.1) as system:
        run = system.run(0.2)
    assert (run.signals["b.y"] == [[4.0, 8.0, 12.0, 16.0]] * 3).all()


@pytest.mark.parametrize("fmi", [2, 3])
def test_component_may_end_the_run(small, fmi):
    with System([Component("stair", small("stair", fmi), {"last": 4})], step_s=0.25) as system:
        run = system.run(10.0)
        with pytest.raises(GraphError, match=r"ended.*; make it again"):
            system.run(20.0)
    assert run.ended == "stair asked to end at 3 s"
    assert run.time_s[-1] == 3.0
    assert run.signals["stair.counter"][-1] == 4
    assert (run.signals["stair.counter"][:5] == [1, 1, 1, 1, 2]).all()


def test_events_are_the_masters_in_event_mode_with_the_same_bounces(small):
    runs = []
    for event_mode in (False, True):
        ball = Component("ball", small("ball"))
        with System([ball], step_s=0.05, event_mode=event_mode) as system:
            runs.append(system.run(1.5))
    inside, outside = runs
    assert outside.signals["ball.h"] == pytest.approx(inside.signals["ball.h"], abs=1e-12)
    assert inside.profile["ball"].steps == 30
    assert outside.profile["ball"].steps == 30 + 2  # bounces at 0.45 and 1.08 s
    fall_s = math.sqrt(2.0 / 9.81)
    top = 0.5 * 9.81 * (0.7 * fall_s) ** 2
    assert max(inside.signals["ball.h"][10:20]) == pytest.approx(top, rel=0.02)


def test_updates_of_states_at_the_start_are_bounded_and_may_end_the_run(small):
    with pytest.raises(FmuError, match=r"instance a, at 0\.00000 s .*10000 updates"):
        System([Component("a", small("restless"), {"mood": 1})], event_mode=True)
    with System([Component("a", small("restless"), {"mood": 2})], event_mode=True) as system:
        run = system.run(1.0)
    assert (run.ended, run.time_s.tolist()) == ("a asked to end at the start", [0.0])


def test_step_that_is_discarded_is_tried_shorter(small):
    component = Component("a", small("dahlquist"), {"longest": 0.02})
    with System([component], step_s=0.01, tolerance=1e-3) as system:
        run = system.run(1.0)
    assert system.rejected > 0
    assert run.signals["a.x"][-1] == pytest.approx(math.exp(-1.0))
    assert run.profile["a"].warnings == 0
    with (
        System([component], step_s=0.05) as system,
        pytest.raises(FmuError, match=r"instance a, at 0.00000 s failed .*: the step is too long"),
    ):
        system.run(1.0)


@pytest.mark.parametrize(("fmi", "text"), [(2, "x is 0.522 of 7 m"), (3, "x is large")])
def test_warnings_are_counted_and_shown(small, caplog, capsys, fmi, text):
    component = Component("a", small("dahlquist", fmi), {"warns_above": 0.5})
    other = Component("b", small("dahlquist", fmi), {"warns_above": 0.01, "x": 2.0})
    for level in ("off", "warnings", "all"):
        caplog.clear()
        with System([component, other], step_s=0.05, fmu_log=level) as system:
            run = system.run(1.0)
        assert (run.profile["a"].warnings, run.profile["b"].warnings) == (13, 20)
        if level == "off":
            assert not caplog.messages
        else:
            first, second = caplog.messages
            assert first == f"component a: 13 of its steps gave a warning; the last one: {text}"
            assert second.startswith("component b: 20 of its steps")
        assert capsys.readouterr().err.count("a: x is ") == (13 if level == "all" else 0)


def test_failure_names_component_time_and_log(small):
    components = [
        Component("good", small("dahlquist")),
        Component("bad", small("dahlquist", 2), {"fails_at": 0.035}),
    ]
    with (
        System(components, step_s=0.01) as system,
        pytest.raises(
            FmuError,
            match=r"instance bad, at 0.03000 s failed \(fmi2Status 3\): cannot go on$",
        ),
    ):
        system.run(1.0)


@pytest.mark.parametrize("algorithm", [*ALGORITHMS, "extrapolated"])
def test_nan_that_passes_unrecorded_is_named_at_its_time(small, algorithm):
    root = Component("p", small("curve"), {"kind": 3})  # of an input that falls below 0 at 0.26 s
    components = [root, Component("q", small("curve"))]
    options = {"record": ["q.next"], "inputs": {"p.u": ([0.0, 1.0], [1.04, -2.96])}}
    links = [Connection("p.y", "q.u")]
    with (
        System(components, links, step_s=0.05, algorithm=algorithm, **options) as system,
        pytest.raises(FmuError, match=r"instance p, at 0\.3[05]000 s puts out nan \(y\)"),
    ):
        system.run(1.0, every=1000)


def test_time_of_components_is_measured_where_wanted(masses):
    with System(masses[3, 3], CONNECTIONS, profile=True) as system:
        run = system.run(0.5)
    assert all(0.0 < share.time_s < 5.0 for share in run.profile.values())
    assert simulated(masses[3, 3], 0.01, 1e-3, "jacobi")[0].profile["first"].time_s == 0.0


def test_instances_go_before_their_binary(small):
    path = small("ball").path
    for _ in range(4):  # in whichever order the garbage collector finds them
        fmu = Fmu(path)
        instance = Instance(Component("a", fmu), fmu)
        instance.begin(0.0, None, None)
        instance.end_initialization()
        vars(fmu)["circle"] = instance
        end = weakref.ref(instance)
        del fmu, instance
        gc.collect()
        assert end() is None


def test_memory_and_descriptors_stay_through_two_thousand_systems(masses):
    def live(count: int) -> tuple[int, int]:
        for _ in range(count):
            simulated(masses[2, 3], 0.005, 1e-3, "jacobi", 1e-3)
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE"), len(list(Path("/proc/self/fd").iterdir()))

    rss, descriptors = live(500)
    later, same = live(1500)
    assert same == descriptors
    assert later - rss < 1 << 20, f"{(later - rss) >> 10} KiB more after 1500 systems"


@pytest.mark.parametrize("fmi", [2, 3])
def test_fmus_are_told_when_the_simulation_stops(small, fmi):
    plant = [Component("plant", small("dahlquist", fmi), {"needs_stop": 1.0})]
    with pytest.raises(FmuError, match="plant"):
        System(plant)
    with System(plant, stop_s=0.1) as system:
        assert system.run(0.1).time_s[-1] == pytest.approx(0.1)
        with pytest.raises(GraphError, match=r"stop_s = 0\.1 is before 0\.2 s"):
            system.run(0.2)
