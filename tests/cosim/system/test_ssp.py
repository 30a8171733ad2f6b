"""Systems from SSP files, and the command that simulates them."""

import json
import zipfile
from pathlib import Path

import numpy as np
import pytest

from cosim.recording.rrd import read_rrd
from cosim.system.graph import Connection, GraphError
from cosim.system.ssp.reader import DESCRIPTION, read_system
from cosim.system.system import System
from tests.references.two_masses import simulated, two_masses

FILE = """<?xml version="1.0" encoding="UTF-8"?>
<ssd:SystemStructureDescription version="{version}" name="masses"
  xmlns:ssd="http://ssp-standard.org/SSP1/SystemStructureDescription"
  xmlns:ssc="http://ssp-standard.org/SSP1/SystemStructureCommon"
  xmlns:ssm="http://ssp-standard.org/SSP1/SystemStructureParameterMapping"
  xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues">
<ssd:System name="masses">
  {bindings}
  <ssd:Elements>
    <ssd:Component name="first" type="application/x-fmu-sharedlibrary" source="resources/2.fmu">
      <ssd:Connectors>
        <ssd:Connector name="x" kind="output"><ssc:Real unit="m"/></ssd:Connector>
        <ssd:Connector name="F_in" kind="input"><ssc:Real unit="N"/></ssd:Connector>
      </ssd:Connectors>
      <ssd:ParameterBindings><ssd:ParameterBinding source="resources/first.ssv"/>
      </ssd:ParameterBindings>
    </ssd:Component>
    {second}
  </ssd:Elements>
  <ssd:Connections>{connections}</ssd:Connections>
</ssd:System>
<ssd:DefaultExperiment startTime="0" stopTime="0.1"/>
</ssd:SystemStructureDescription>"""
SECOND = """<ssd:Component name="second" source="resources/3.fmu">
  <ssd:Connectors>
    <ssd:Connector name="F" kind="output"/><ssd:Connector name="x_in" kind="input"/>
  </ssd:Connectors>
  <ssd:ParameterBindings><ssd:ParameterBinding>
    <ssd:ParameterValues>{values}</ssd:ParameterValues>
  </ssd:ParameterBinding></ssd:ParameterBindings>
</ssd:Component>"""
NESTED = """<ssd:System name="box"><ssd:Connectors>
  <ssd:Connector name="force" kind="output"/><ssd:Connector name="place" kind="input"/>
</ssd:Connectors><ssd:Elements>{second}</ssd:Elements><ssd:Connections>
  <ssd:Connection startConnector="force" endElement="second" endConnector="F"/>
  <ssd:Connection startConnector="place" endElement="second" endConnector="x_in">
    {transformation}
  </ssd:Connection></ssd:Connections></ssd:System>"""
FORCE = (
    '<ssd:Connection startElement="{}" startConnector="{}" endElement="first" endConnector="F_in"/>'
)
PLACE = (
    '<ssd:Connection startElement="first" startConnector="x" endElement="{}" endConnector="{}"/>'
)


def values(**numbers: object) -> str:
    """A parameter set."""
    parameters = "".join(
        f'<ssv:Parameter name="{name}"><ssv:Real value="{value}"/></ssv:Parameter>'
        for name, value in numbers.items()
    )
    return (
        '<ssv:ParameterSet version="1.0" name="values" '
        'xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues">'
        f"<ssv:Parameters>{parameters}</ssv:Parameters></ssv:ParameterSet>"
    )


FLAT = {
    "bindings": "",
    "second": SECOND.format(values=values(k=1000, k_c=100, x=0, unknown=1)),
    "connections": FORCE.format("second", "F") + PLACE.format("second", "x_in"),
    "version": "1.0",
}


@pytest.fixture(scope="module")
def masses(tmp_path_factory):
    return two_masses(tmp_path_factory.mktemp("masses"), (2, 3))


@pytest.fixture
def archive(masses, tmp_path):
    """An .ssp file of both oscillators, with another description where wanted."""

    def make(**differences: str) -> Path:
        path = tmp_path / "masses.ssp"
        with zipfile.ZipFile(path, "w") as file:
            file.writestr(DESCRIPTION, FILE.format(**(FLAT | differences)))
            file.writestr("resources/first.ssv", values(k=10))
            for component in masses:
                file.write(component.fmu.path, f"resources/{component.fmu.path.name}")
        return path

    return make


def run(path: Path):
    found = read_system(path)
    with System(found.components, found.connections, start_s=found.start_s or 0.0) as system:
        return system.run(found.stop_s or 0.0)


@pytest.mark.parametrize("version", ["1.0", "2.0"])
def test_archive_gives_the_bits_of_the_same_system_in_python(archive, masses, version):
    expected, _ = simulated(masses, 0.1, 1e-3, "jacobi")
    found = run(archive(version=version))
    assert found.signals.keys() == expected.signals.keys()
    for name, signal in expected.signals.items():
        assert (found.signals[name] == signal).all()


def test_one_of_several_descriptions_is_chosen(archive, masses, tmp_path, command):
    path = archive()
    stiff = FLAT | {"second": SECOND.format(values=values(k=2000, k_c=100, x=0))}
    with zipfile.ZipFile(path, "a") as file:
        file.writestr("stiff.ssd", FILE.format(**stiff))
    ends = []
    for variant in ([], ["--variant", "stiff.ssd"]):
        done = command("system", path, *variant, "--no-isolate", "--json")
        ends.append(json.loads(done.stdout.splitlines()[-1])["last"]["second.x"])
    assert ends[0] != ends[1]
    for name, said in (("soft.ssd", "choose from SystemStructure.ssd, stiff.ssd"), ("", "no")):
        with pytest.raises(GraphError, match=said):
            read_system(path, variant=name)


def test_description_alone_stands_beside_its_fmus(archive, masses, tmp_path):
    with zipfile.ZipFile(archive()) as file:
        file.extractall(tmp_path)
    expected, _ = simulated(masses, 0.1, 1e-3, "jacobi")
    assert (run(tmp_path / DESCRIPTION).signals["first.x"] == expected.signals["first.x"]).all()


def test_systems_in_systems_are_taken_apart(archive):
    linear = '<ssc:LinearTransformation factor="2" offset="1"/>'
    nested = NESTED.format(second=FLAT["second"], transformation=linear)
    connections = FORCE.format("box", "force") + PLACE.format("box", "place")
    found = read_system(archive(second=nested, connections=connections))
    assert [component.name for component in found.components] == ["first", "box.second"]
    assert set(found.connections) == {
        Connection("box.second.F", "first.F_in", convert=False),
        Connection("first.x", "box.second.x_in", 2.0, 1.0, convert=False),
    }


def test_outer_parameters_go_first_and_are_mapped(archive):
    mapping = (
        '<ssd:ParameterMapping><ssm:ParameterMapping version="1.0">'
        '<ssm:MappingEntry source="second.stiffness" target="second.k">'
        '<ssc:LinearTransformation factor="1000"/></ssm:MappingEntry>'
        "</ssm:ParameterMapping></ssd:ParameterMapping>"
    )
    bindings = (
        '<ssd:ParameterBindings><ssd:ParameterBinding prefix="second."><ssd:ParameterValues>'
        f"{values(stiffness=2, k_c=50)}</ssd:ParameterValues>{mapping}"
        "</ssd:ParameterBinding></ssd:ParameterBindings>"
    )
    first, second = read_system(archive(bindings=bindings)).components
    assert first.start == {"k": "10"}
    assert {name: float(text) for name, text in second.start.items()} == {
        "k": 2000.0, "k_c": 100.0, "x": 0.0,  # the mapping does not name k_c
    }  # fmt: skip


def test_values_in_another_unit_are_converted_or_refused(archive):
    inches = (
        '<ssv:ParameterSet version="1.0" name="values"><ssv:Parameters><ssv:Parameter name="x">'
        '<ssv:Real value="10" unit="{}"/></ssv:Parameter></ssv:Parameters><ssv:Units>'
        '<ssc:Unit name="in"><ssc:BaseUnit m="1" factor="0.0254"/></ssc:Unit>'
        '<ssc:Unit name="h"><ssc:BaseUnit s="1" factor="3600"/></ssc:Unit></ssv:Units>'
        "</ssv:ParameterSet>"
    )
    found = read_system(archive(second=SECOND.format(values=inches.format("in"))))
    assert float(found.components[1].start["x"]) == pytest.approx(0.254)
    with pytest.raises(GraphError, match=r"'x': units h and m"):
        read_system(archive(second=SECOND.format(values=inches.format("h"))))


@pytest.mark.parametrize(
    ("second", "words"),
    [
        (
            '<ssd:Component name="second" source="../3.fmu"/>',
            "source '../3.fmu' is not a file in it",
        ),
        ('<ssd:Component name="first" source="resources/3.fmu"/>', "first appears twice"),
        (
            '<ssd:Component name="second" type="application/x-ssp-package" source="a.ssp"/>',
            "component second is of type application/x-ssp-package; put FMUs in its place",
        ),
        (
            '<ssd:Component name="second" implementation="ScheduledExecution" source="a.fmu"/>',
            "component second is for ScheduledExecution; choose from any, CoSimulation",
        ),
        (
            NESTED.format(
                second=FLAT["second"], transformation='<ssc:LinearTransformation factor="x"/>'
            ),
            "could not convert string to float: 'x'; export it as SSP 1.0 or 2.0",
        ),
        ("<ssd:Component", "masses.ssp: not a system file or damaged"),
    ],
)
def test_what_is_not_supported_is_named(archive, second, words):
    with pytest.raises(GraphError) as caught:
        read_system(archive(second=second))
    assert words in str(caught.value)


def test_file_that_is_none_is_named(tmp_path):
    path = tmp_path / "none.ssp"
    with pytest.raises(GraphError, match="no such system file"):
        read_system(path)
    path.write_text("no system")
    with pytest.raises(GraphError, match="not a system file or damaged"):
        read_system(path)


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_command_writes_what_it_recorded(archive, command, tmp_path, suffix):
    import pyarrow.csv
    import pyarrow.parquet

    out = tmp_path / f"run.{suffix}"
    arguments = ["--algorithm", "gauss-seidel", "--profile", "--out", out, "--json", "--every", 10]
    done = command(
        "system", archive(), *arguments, "--no-isolate", "--record", "first.x", "second.F"
    )
    assert (done.returncode, "error" in done.stderr) == (0, False), done.stderr
    told = json.loads(done.stdout.splitlines()[-1])
    assert (told["steps"], told["rejected"], told["ended"]) == (100, 0, None)
    assert told["profile"]["second"]["steps"] == 100
    assert told["profile"]["second"]["time_s"] > 0.0
    read = pyarrow.csv.read_csv if suffix == "csv" else pyarrow.parquet.read_table
    table = read(out)
    assert table.column_names == ["time", "first.x", "second.F"]
    assert np.asarray(table["time"]) == pytest.approx(np.arange(11) * 0.01)
    assert table["first.x"][-1].as_py() == told["last"]["first.x"]


def test_command_takes_steps_of_components_and_power_bonds(archive, command, tmp_path):
    words = ["--component-step", "second=5e-4", "--component-step", "first=2e-3", "--json"]
    done = command("system", archive(), "--no-isolate", *words)
    assert done.returncode == 0, done.stderr
    profile = json.loads(done.stdout.splitlines()[-1])["profile"]
    assert (profile["first"]["steps"], profile["second"]["steps"]) == (50, 200)
    words = ["--power-bond", "first.F_in=second.x_in", "--out", tmp_path / "run.rrd"]
    done = command("system", archive(), "--no-isolate", *words)
    assert done.returncode == 0, done.stderr
    assert "first.F_in residual energy = " in done.stdout
    assert (
        read_rrd(tmp_path / "run.rrd").signals["/first/F_in\\ residual\\ energy"].values[-1] != 0.0
    )


PARAMETERS = """<SystemStructureDescription version="1.0" name="s"
xmlns="http://ssp-standard.org/SSP1/SystemStructureDescription"><System name="s"><Elements>
<System name="box"><Connectors><Connector name="twice" kind="calculatedParameter"/></Connectors>
<Elements><Component name="a" source="a.fmu"/></Elements><Connections>
<Connection startElement="a" startConnector="double_k" endConnector="twice"/></Connections></System>
<Component name="b" source="a.fmu"/><Component name="namer" source="n.fmu"/>
<Component name="through" source="f.fmu"/></Elements><Connections>
<Connection startElement="box" startConnector="twice" endElement="b" endConnector="k"/>
<Connection startElement="namer" startConnector="name" endElement="through"
 endConnector="String_input"/></Connections></System></SystemStructureDescription>"""


@pytest.mark.parametrize("suffix", ["csv", "rrd"])
def test_command_passes_on_texts_and_calculated_parameters(small, command, tmp_path, suffix):
    for name, model in (("a", "dahlquist"), ("n", "namer"), ("f", "feedthrough")):
        (tmp_path / f"{name}.fmu").write_bytes(small(model).path.read_bytes())
    (tmp_path / "s.ssd").write_text(PARAMETERS)
    out = tmp_path / f"run.{suffix}"
    words = ["--until", 2, "--step", 1, "--json", "--no-isolate", "--out", out]
    words += ["--record", "b.double_k", "b.x", "through.String_output"]
    done = command("system", tmp_path / "s.ssd", *words)
    assert done.returncode == 0, done.stderr
    last = json.loads(done.stdout.splitlines()[-1])["last"]
    expected = {"b.double_k": 4.0, "through.String_output": "step 1"}
    assert last == expected | {"b.x": pytest.approx(np.exp(-4.0))}
    if suffix == "rrd":
        assert read_rrd(out).texts["/through/String_output"].texts[-2:] == ("", "step 1")
    else:
        assert out.read_text().splitlines()[-1].endswith('"step 1"')


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--step", "3e-4"), "time to run to = 0.1 s is not a whole multiple of step = 0.0003 s"),
        (("--record", "first.q"), "component first has no variable 'q'"),
        (("--out", "run.txt"), "--out run.txt: name a .csv, .parquet or .rrd file"),
        (("--every", "0"), "every 0 steps: choose 1 or more"),
    ],
)
def test_command_refuses_in_one_sentence(archive, command, arguments, words):
    done = command("system", archive(), "--no-isolate", *arguments)
    assert done.returncode == 2
    assert words in done.stderr
    assert done.stderr.count("\n") == 1
