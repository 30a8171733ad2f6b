"""Systems that cannot be: one sentence that names component, variable or connection."""

import math
import zipfile
from pathlib import Path

import pytest

from cosim.base.errors import UserError
from cosim.fmi.fmu import Fmu, FmuError
from cosim.model.config import ConfigError
from cosim.system.graph import Component, Connection, GraphError, find
from cosim.system.system import System


def changed(fmu: Fmu, folder: Path, *replaced: str) -> Path:
    """Copy of an FMU with other words in its description: old and new ones by turns."""
    path = folder / f"{len(list(folder.iterdir()))}.fmu"
    with zipfile.ZipFile(fmu.path) as source, zipfile.ZipFile(path, "w") as target:
        for name in source.namelist():
            content = source.read(name)
            if name == "modelDescription.xml":
                text = content.decode()
                for old, new in zip(replaced[::2], replaced[1::2], strict=True):
                    assert old in text
                    text = text.replace(old, new)
                content = text.encode()
            target.writestr(name, content)
    return path


@pytest.fixture
def refused(small):
    """What the refusal of a system says; components a (oscillator), b and c (feedthrough)."""

    def said(*connections: Connection, error: type[UserError] = GraphError, **options) -> str:
        through = small("feedthrough")
        components = options.pop("components", None) or [
            Component("a", small("oscillator")),
            Component("b", through),
            Component("c", through),
        ]
        with pytest.raises(error) as caught:
            System(components, connections, step_s=0.1, **options)
        assert "\n" not in str(caught.value)
        return str(caught.value)

    return said


@pytest.mark.parametrize(
    ("source", "target", "words"),
    [
        ("a.y", "b.Float64_input", "component a has no variable 'y'"),
        (
            "d.x",
            "b.Float64_input",
            "'d.x' is not a variable of a component; components are a, b, c",
        ),
        ("x", "b.Float64_input", "'x' is not a variable of a component"),
        ("a.F_in", "b.Float64_input", "they are of causality input and input; connect an output"),
        (
            "b.Float64_output",
            "a.k",
            "they are of causality output and parameter; connect an output",
        ),
        ("b.Boolean_output", "c.Int32_input", "Boolean does not fit into Int32"),
        ("b.Int32_output", "c.Boolean_input", "Int32 does not fit into Boolean"),
        ("b.Int32_output", "c.Enumeration_input", "Int32 does not fit into Enumeration"),
        ("b.Float64_output", "c.Float32_input", "Float64 does not fit into Float32"),
        ("b.Int64_output", "c.Float64_input", "Int64 does not fit into Float64"),
        ("b.UInt32_output", "c.Int32_input", "UInt32 does not fit into Int32"),
        ("b.Int8_output", "c.UInt64_input", "Int8 does not fit into UInt64"),
        ("a.F", "a.x_in", "units N and m do not match"),
    ],
)
def test_connection_is_refused_by_its_ends(refused, source, target, words):
    assert words in refused(Connection(source, target))


def test_input_has_one_connection(refused):
    target = "c.Float64_input"
    said = refused(Connection("b.Float64_output", target), Connection("a.v", target))
    assert said == f"connection a.v -> {target}: another connection sets this input; remove one"


def test_integers_are_not_scaled(refused):
    said = refused(Connection("b.Int32_output", "c.Int32_input", 2.0))
    assert "values of type Int32 cannot be scaled" in said


def test_undeclared_dependencies_are_no_reason_to_refuse(small):
    through = small("feedthrough", told=False)  # any output may depend on any input
    links = [Connection("b.Float64_output", "c.Float64_input"),
             Connection("c.Int32_output", "b.Int32_input")]  # fmt: skip
    start = {"b": {"Float64_input": 2.5}, "c": {"Int32_input": 7}}
    with System([Component(n, through, start[n]) for n in "bc"], links, step_s=0.1) as system:
        run = system.run(0.1)
    assert (run.signals["c.Float64_output"] == 2.5).all()
    assert (run.signals["b.Int32_output"] == 7).all()


def test_values_that_never_settle_are_named(small):
    component = Component("a", small("curve"))
    with pytest.raises(GraphError, match=r"a\.next -> a\.count .*1000"):
        System([component], [Connection("a.next", "a.count")])


def test_arrays_have_one_shape(refused, small):
    arrays = small("array")
    components = [Component("p", arrays, {"n": 2, "u": [0, 0]}), Component("q", arrays)]
    said = refused(Connection("p.y", "q.u"), components=components)
    assert "shapes (2,) and (3,) do not match" in said


@pytest.mark.parametrize(
    ("start", "words"),
    [
        ({"z": 1}, "component s has no variable 'z'; its modelDescription.xml names"),
        ({"Float64_output": 1}, "'Float64_output' of causality output takes no start value"),
        ({"Float64_input": "fast"}, "start value 'fast' of 'Float64_input' is not of type Float64"),
        ({"Int32_input": 1.5}, "start value 1.5 of 'Int32_input' is not of type Int32"),
        (
            {"Boolean_input": "maybe"},
            "start value 'maybe' of 'Boolean_input' is not of type Boolean",
        ),
        ({"Int32_input": [1, 2]}, "start value [1, 2] of 'Int32_input' has 2 values; give it 1"),
    ],
)
def test_start_value_is_refused(refused, small, start, words):
    components = [Component("s", small("feedthrough"), start)]
    assert words in refused(components=components)


@pytest.mark.parametrize(
    ("name", "value"),
    [("Int8_input", 300), ("UInt8_input", -1), ("Int64_input", 2**63), ("Enumeration_input", 3),
     ("Float32_input", 1e300), ("Float64_input", float("nan")), ("Int8_input", "300")],
)  # fmt: skip
def test_start_value_out_of_range_is_refused(refused, small, name, value):
    components = [Component("s", small("feedthrough"), {name: value})]
    said = refused(components=components)
    assert f"start value {value!r} of '{name}' is out of range; use " in said


def test_declared_limits_hold_for_start_values(refused, small, tmp_path):
    limited = changed(small("oscillator"), tmp_path, 'name="k"', 'name="k" min="0.5" max="2"')
    for value in (0.25, 3.0):
        said = refused(components=[Component("s", limited, {"k": value})])
        assert said.endswith(f"start value {value} of 'k' is out of range; use 0.5 to 2")


@pytest.mark.parametrize("scale", [(math.inf, 0.0), (1.0, math.nan)])
def test_connections_scale_by_finite_numbers(refused, scale):
    assert "must be finite" in refused(Connection("a.x", "b.Float64_input", *scale))


def test_only_one_instance_of_what_shares_its_memory(refused, small, tmp_path):
    word = "<CoSimulation "
    once = changed(small("ball"), tmp_path, word, f'{word}canBeInstantiatedOnlyOncePerProcess="1" ')
    copy, packed = tmp_path / "copy.fmu", tmp_path / "packed.fmu"
    copy.write_bytes(once.read_bytes())
    with zipfile.ZipFile(once) as source, zipfile.ZipFile(packed, "w") as target:
        for name in source.namelist():  # other bytes, the same instantiation token
            target.writestr(name, source.read(name))
    for other in (once, copy, packed):
        said = refused(components=[Component("a", once), Component("b", other)])
        assert said.startswith("component b: ") and "component a is of the same FMU" in said


def test_an_alias_is_its_input(refused, small, tmp_path):
    named = changed(
        small("dahlquist"),
        tmp_path,
        'start="0"></Float64>',
        'start="0"><Alias name="v"/></Float64>',
    )
    components = [Component("a", small("oscillator")), Component("b", named)]
    said = refused(Connection("a.x", "b.u"), Connection("a.v", "b.v"), components=components)
    assert said == "connection a.v -> b.v: another connection sets this input; remove one"


def test_differences_keep_their_size_and_do_not_mix(refused, small, tmp_path):
    degrees, kelvin = (
        changed(
            small("feedthrough"), tmp_path, f'name="Float64_{end}"',
            f'name="Float64_{end}" unit="{unit}" relativeQuantity="true"', "</UnitDefinitions>",
            '<Unit name="degC"><BaseUnit K="1" offset="273.15"/></Unit><Unit name="K">'
            '<BaseUnit K="1"/></Unit></UnitDefinitions>',
        )
        for end, unit in (("output", "degC"), ("input", "K"))
    )  # fmt: skip
    link = Connection("a.Float64_output", "b.Float64_input")
    components = [Component("a", degrees, {"Float64_input": 5.0}), Component("b", kelvin)]
    with System(components, [link], step_s=0.1) as system:
        assert system.run(0.1).signals["b.Float64_output"][-1] == 5.0
    mixed = changed(Fmu(kelvin), tmp_path, 'relativeQuantity="true"', 'relativeQuantity="false"')
    components[1] = Component("b", mixed)
    said = refused(link, components=components)
    assert "one of degC and K is a difference (relativeQuantity)" in said


def test_the_longest_name_of_a_component_counts(small):
    fmus = {"axle": small("ball"), "axle.left": small("oscillator")}
    assert find(fmus, "axle.left.x") == ("axle.left", "x")
    assert find(fmus, "axle.h") == ("axle", "h")
    with pytest.raises(GraphError, match=r"axle\.left .*'h'"):
        find(fmus, "axle.left.h")


def test_components_are_named_once_and_there(refused, small, tmp_path):
    twice = [Component("a", small("ball")), Component("a", small("stair"))]
    assert refused(components=twice) == "two components are named a; rename one"
    missing = [Component("a", tmp_path / "none.fmu")]
    assert "does not exist or is a folder; check its path" in refused(
        components=missing, error=FmuError
    )
    with pytest.raises(GraphError, match="no component"):
        System([])


def test_steps_have_to_fit(refused, small):
    words = "cannot save its state (canGetAndSetFMUState), which a tolerance needs"
    components = [Component("a", small("dahlquist", 2, able=False))]
    assert words in refused(components=components, tolerance=1e-3, error=FmuError)
    assert "tolerance 0: choose one above 0" in refused(tolerance=0.0)
    assert "longest step nan: choose one above 0" in refused(longest_step_s=float("nan"))
    said = refused(tolerance=1e-3, longest_step_s=0.25, error=ConfigError)
    assert said.startswith("longest step = 0.25 s is not a whole multiple of step = 0.1 s")
    with System([Component("a", small("ball"))], step_s=0.1) as system:
        with pytest.raises(ConfigError, match=r"= 0\.25 s .*multiple"):
            system.run(0.25)
        with pytest.raises(GraphError, match=r"inf: choose .*above 0"):
            system.run(float("inf"))
        system.run(0.1)
        with pytest.raises(GraphError, match=r"0\.1 s; run .*later"):
            system.run(0.1)
    with pytest.raises(GraphError, match="been closed; make it again"):
        system.run(0.2)


def test_fixed_internal_step_divides_the_step(refused, small):
    components = [Component("a", small("ball", internal_s=0.03))]
    said = refused(components=components, error=ConfigError)
    assert said.startswith("step = 0.1 s is not a whole multiple of fixedInternalStepSize of FMU ")
    components = [Component("a", small("ball", internal_s=0.0))]
    assert "fixedInternalStepSize = 0;" in refused(components=components, error=FmuError)
