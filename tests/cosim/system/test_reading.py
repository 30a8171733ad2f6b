"""SSP files as the standard says: every element and attribute has its effect, or is refused."""

import zipfile
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree as ET

import fmpy
import pytest

from cosim.fmi.fmu import Fmu
from cosim.system.graph import Component, GraphError
from cosim.system.ssp.reader import DESCRIPTION, read_system
from cosim.system.ssp.schema import KNOWN, NO_EFFECT, NOTES, check
from cosim.system.system import System

_XS = "{http://www.w3.org/2001/XMLSchema}"
_SCHEMAS = Path(fmpy.__file__).parent / "ssp" / "schema"
# What the schemas of SSP 2.0 have in addition to those of 1.0, which fmpy has.
_INTEGERS = tuple(f"{sign}Int{bits}" for sign in ("", "U") for bits in (8, 16, 32, 64))
_NEW_TYPES = ("Float64", "Float32", *_INTEGERS)
_OF_SSP_2 = {
    "Connection": ("startIndices endIndices", ""),
    "Connector": ("", f"{' '.join(_NEW_TYPES)} Dimension Clock"),
    "Dimension": ("size sizeConnector", ""),
    "Clock": ("name", ""),
    "ConnectorGeometry": ("systemInnerX systemInnerY", ""),
    "Parameter": ("", f"{' '.join(_NEW_TYPES)} Dimension"),
    "String": ("", "Value"),
    "Enumeration": ("", "Value"),
    "Binary": ("", "Value"),
    "Value": ("value", ""),
    "ParameterBinding": ("", "MetaData Signature"),
    "SystemStructureDescription": ("", "MetaData Signature"),
    "ParameterSet": ("", "MetaData Signature"),
    **dict.fromkeys(("Float64", "Float32"), ("unit value", "")),
    **dict.fromkeys(_INTEGERS, ("value", "")),
}
_REFUSED = {
    "SignalDictionaries", "SignalDictionaryReference", "Clock", "BooleanMappingTransformation",
    "IntegerMappingTransformation", "EnumerationMappingTransformation",
}  # fmt: skip


def schema() -> dict[str, tuple[set[str], set[str]]]:
    """Attributes and child elements by the name of the element that may have them."""
    named: dict[str, ET.Element] = {}
    roots = [ET.parse(path).getroot() for path in _SCHEMAS.glob("*[!1].xsd")]
    for root in roots:
        named |= {each.get("name", ""): each for each in root if each.get("name")}
    found: dict[str, tuple[set[str], set[str]]] = {}

    def collect(node: ET.Element, attributes: set[str], elements: set[str]) -> None:
        for child in node:
            kind, name = child.tag.removeprefix(_XS), child.get("name", "")
            refers = (child.get("ref") or child.get("base") or "").rpartition(":")[2]
            if kind == "attribute":
                attributes.add(name)
            elif kind == "element":
                elements.add(name or refers)
            else:
                if refers in named:
                    collect(named[refers], attributes, elements)
                collect(child, attributes, elements)

    for root in roots:
        for element in root.iter(f"{_XS}element"):
            if name := element.get("name"):
                attributes, elements = found.setdefault(name, (set(), set()))
                kind = (element.get("type") or "").rpartition(":")[2]
                collect(named.get(kind, element), attributes, elements)
    for name, (attributes, elements) in _OF_SSP_2.items():
        known = found.setdefault(name, (set(), set()))
        known[0].update(attributes.split())
        known[1].update(elements.split())
    return found


def test_every_element_and_attribute_of_the_schema_is_read_or_refused_by_name():
    walked = schema()
    assert len(walked) > 50
    assert {"startIndices", "suppressUnitConversion"} <= walked["Connection"][0]
    assert {"Connectors", "ParameterBindings", "Elements"} <= walked["System"][1]
    for name, (attributes, elements) in walked.items():
        if name in NO_EFFECT or name not in KNOWN:
            assert name in NO_EFFECT | _REFUSED | {
                "MapEntry", "Note", "Annotation", "SignalDictionary", "DictionaryEntry"
            }  # fmt: skip
            continue
        for attribute in attributes - KNOWN[name][0] - NOTES:
            with pytest.raises(GraphError, match=f"attribute {attribute} of {name} is not supp"):
                check(ET.Element(name, {attribute: "x"}), "it")
        for inner in elements - KNOWN[name][1]:
            root = ET.Element(name)
            ET.SubElement(root, inner)
            if inner in NO_EFFECT:
                check(root, "it")
            else:
                assert inner in _REFUSED
                with pytest.raises(GraphError, match=f"{inner} in {name} is not supported"):
                    check(root, "it")
    # Nothing is read that no schema has: a name written wrong would be refused for ever.
    for name, (attributes, elements) in KNOWN.items():
        assert attributes <= walked[name][0] | {"version", "source", "sourceBase", "type"}
        assert elements <= walked[name][1] | {"ParameterSet", "ParameterMapping", "MappingEntry"}


_FILE = """<SystemStructureDescription xmlns="http://ssp-standard.org/SSP1/{0}Description"
  xmlns:ssc="http://ssp-standard.org/SSP1/{0}Common"
  xmlns:ssv="http://ssp-standard.org/SSP1/{0}ParameterValues"
  xmlns:ssm="http://ssp-standard.org/SSP1/{0}ParameterMapping" version="2.0" name="it">
<System name="it">{1}</System>{2}</SystemStructureDescription>"""


@pytest.fixture
def simulated(small: Callable[..., Fmu], tmp_path: Path) -> Callable[..., dict[str, list]]:
    """Last values of a system of components a, b, … of models, by variables."""

    def run(text: str, after: str = "", fmi: int = 3, until_s: float = 0.2, **models) -> dict:
        path = tmp_path / "it.ssp"
        fmus = {
            name: small(*(m if isinstance(m, tuple) else (m, fmi))) for name, m in models.items()
        }
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr(DESCRIPTION, _FILE.format("SystemStructure", text, after))
            for name, fmu in fmus.items():
                archive.write(fmu.path, f"resources/{name}.fmu")
        found = read_system(path)
        with System(found.components, found.connections, step_s=0.1) as system:
            values = system.run(until_s).signals
        return {name: signal[-1].tolist() for name, signal in values.items()}

    return run


def component(name: str, inner: str = "") -> str:
    return f'<Component name="{name}" source="resources/{name}.fmu">{inner}</Component>'


def bindings(mapping: str = "", attributes: str = "", **values: object) -> str:
    parameters = "".join(
        f'<ssv:Parameter name="{name.replace("__", ".")}"><ssv:Float64 value="{value}"/>'
        "</ssv:Parameter>"
        for name, value in values.items()
    )
    return (
        f"<ParameterBindings><ParameterBinding {attributes}><ParameterValues>"
        '<ssv:ParameterSet version="2.0" name="v"><ssv:Parameters>'
        f"{parameters}</ssv:Parameters></ssv:ParameterSet></ParameterValues>{mapping}"
        "</ParameterBinding></ParameterBindings>"
    )


def connection(start: str, end: str, inner: str = "", **attributes: str) -> str:
    text = ""
    for side, name in (("start", start), ("end", end)):
        element, _, connector = name.rpartition(".")
        text += f'{side}Element="{element}" ' if element else ""
        text += f'{side}Connector="{connector}" '
    text += " ".join(f'{name}="{value}"' for name, value in attributes.items())
    return f"<Connection {text}>{inner}</Connection>"


def connections(*texts: str) -> str:
    return f"<Connections>{''.join(texts)}</Connections>"


@pytest.mark.parametrize(
    ("start", "end", "words"),
    [
        ("a.F", "c.F_in", "there is no element c; correct endElement"),
        ("d.F", "a.F_in", "there is no element d; correct startElement"),
        ("a.F", "a.q", "component a has no variable 'q'"),
        ("a.F", "q", "there is no connector q"),
        ("a.F", "a.x", "each of them gives a value"),
        ("a.F_in", "a.x_in", "none of them gives a value"),
    ],
)
def test_connections_lead_to_what_there_is(simulated, start, end, words):
    elements = f"<Elements>{component('a')}</Elements>"
    with pytest.raises(GraphError, match=words):
        simulated(elements + connections(connection(start, end)), a="oscillator")


def test_values_for_connectors_of_systems_arrive(simulated):
    declared = '<Connectors><Connector name="gain" kind="parameter"/></Connectors>'
    given = declared + bindings(gain=3.0)
    inner = (
        f'<System name="box">{declared}<Elements>{component("a", bindings(k=7.0))}</Elements>'
        f"{connections(connection('gain', 'a.k'))}</System>"
    )
    wires = connections(connection("gain", "box.gain"))
    found = simulated(f"{given}<Elements>{inner}</Elements>{wires}", a="oscillator", until_s=0.1)
    # x'' = -3 x from 1: the outer value goes before the component's own.
    assert found["box.a.x"] == pytest.approx(0.98503746)
    scaled = connections(connection("gain", "a.k", '<ssc:LinearTransformation factor="2"/>'))
    elements = f"<Elements>{component('a')}</Elements>"
    found = simulated(given + elements + scaled, a="oscillator", until_s=0.1)
    assert found["a.x"] == pytest.approx(0.97014931)


@pytest.mark.parametrize("entries", ['<ssm:MappingEntry source="stiffness" target="a.k"/>', ""])
def test_values_that_a_mapping_does_not_name_are_not_applied(simulated, entries):
    mapping = (
        '<ParameterMapping><ssm:ParameterMapping version="2.0">'
        f"{entries}</ssm:ParameterMapping></ParameterMapping>"
    )
    text = bindings(mapping, stiffness=3.0, a__x=5.0) + f"<Elements>{component('a')}</Elements>"
    found = simulated(text, a="oscillator", until_s=0.1)
    assert found["a.x"] == pytest.approx(0.98503746 if entries else 0.99500417)


def test_indices_choose_elements_of_arrays(simulated):
    values = "<ssv:Parameter name='u'><ssv:Float64 value='1 2 3'/></ssv:Parameter>"
    given = bindings().replace("<ssv:Parameters>", f"<ssv:Parameters>{values}")
    elements = f"<Elements>{component('a', given)}{component('b')}</Elements>"
    wires = connections(connection("a.y", "b.u", startIndices="3", endIndices="1"))
    found = simulated(elements + wires, a="array", b="array")
    assert found["a.y"] == [2.0, 4.0, 6.0]
    assert found["b.y"] == [12.0, 0.0, 0.0]
    for attributes in ({"startIndices": "4", "endIndices": "1"}, {"startIndices": "1 1"}):
        with pytest.raises(GraphError, match=r"of shape \(3,\) has no element"):
            wires = connections(connection("a.y", "b.u", **attributes))
            simulated(elements + wires, a="array", b="array")


def test_scalars_are_connected_to_elements_of_arrays(simulated):
    elements = f"<Elements>{component('a')}{component('b')}</Elements>"
    wires = connections(
        connection("b.u", "a.x", startIndices="2"), connection("a.v", "b.u", endIndices="3")
    )
    found = simulated(elements + wires, a="oscillator", b="array", until_s=0.1)
    assert found["b.y"] == [0.0, 2.0, 0.0]
    again = connection("a.x", "b.u", endIndices="2")
    with pytest.raises(GraphError, match="another connection sets this input"):
        simulated(elements + wires.replace("</Connections>", again + "</Connections>"),
                  a="oscillator", b="array")  # fmt: skip


_UNITS = (
    '<Units><ssc:Unit name="bar"><ssc:BaseUnit kg="1" m="-1" s="-2" factor="1e5"/></ssc:Unit>'
    '<ssc:Unit name="Pa"><ssc:BaseUnit kg="1" m="-1" s="-2"/></ssc:Unit></Units>'
)


@pytest.mark.parametrize(("attributes", "expected"), [({}, 2e5), ({"s": "1"}, 2.0)])
def test_units_of_connectors_count_where_the_fmu_has_none(simulated, attributes, expected):
    def declared(name: str, kind: str, unit: str) -> str:
        inner = f'<ssc:Float64 unit="{unit}"/>'
        return (
            f'<Connectors><Connector name="{name}" kind="{kind}">{inner}</Connector></Connectors>'
        )

    source = declared("Float64_output", "output", "bar") + bindings(Float64_input=2.0)
    target = declared("Float64_input", "input", "Pa")
    elements = f"<Elements>{component('a', source)}{component('b', target)}</Elements>"
    more = {"suppressUnitConversion": "true"} if attributes else {}
    wires = connections(connection("a.Float64_output", "b.Float64_input", **more))
    found = simulated(elements + wires, _UNITS, a="feedthrough", b="feedthrough")
    assert found["b.Float64_output"] == expected


def test_chains_of_systems_are_followed_without_recursion_and_bounded(simulated):
    box = (
        '<System name="s{0}"><Connectors><Connector name="i" kind="input"/>'
        '<Connector name="o" kind="output"/></Connectors><Connections>'
        '<Connection startConnector="i" endConnector="o"/></Connections></System>'
    )

    def chained(number: int, *more: str, last: bool = True) -> dict:
        elements = component("a") + component("b") + "".join(box.format(k) for k in range(number))
        wires = [connection(f"s{k}.o", f"s{k + 1}.i") for k in range(number - 1)]
        wires += [connection("a.Int32_output", "s0.i")] * last
        wires += [connection(f"s{number - 1}.o", "b.Int32_input"), *more]
        given = bindings(a__Int32_input=5).replace("Float64 value", "Int32 value")
        text = f"{given}<Elements>{elements}</Elements>{connections(*wires)}"
        return simulated(text, a="feedthrough", b="feedthrough")

    assert chained(1500)["b.Int32_output"] == 5
    with pytest.raises(GraphError, match=r"s1\.i; remove one"):
        chained(40, connection("s0.o", "s1.i"))
    with pytest.raises(GraphError, match="lead in a circle at s"):
        chained(20, connection("s9.o", "s0.i"), last=False)
    nested = '<System name="s"><Elements>' * 3000 + "</Elements></System>" * 3000
    with pytest.raises(GraphError, match=r"nested .*200"):
        simulated(f"<Elements>{nested}</Elements>")


def test_dimensions_are_bounded(small, tmp_path):
    path = tmp_path / "huge.fmu"
    with zipfile.ZipFile(small("array").path) as usual, zipfile.ZipFile(path, "w") as huge:
        for name in usual.namelist():
            huge.writestr(name, usual.read(name).replace(b'start="3"', b'start="4294967296"'))
    with pytest.raises(GraphError, match="the system take 32768 MiB, more than 256; choose small"):
        System([Component("a", path)])
