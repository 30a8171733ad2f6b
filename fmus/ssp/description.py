"""`SystemStructure.ssd` of a system of FMUs, and its parameters as a file of their own (SSV).

The markup keeps to what importers have in common: no connectors of the system, no connectors but
connected ones, and parameter sets of one name within every component. SSP 1.0 knows Real alone, SSP
2.0 the types of FMI 3.0; both have one set of namespaces.
"""

from collections.abc import Mapping
from typing import Literal
from xml.etree import ElementTree as ET

from fmus.description import to_bytes
from fmus.models import Fmi, Model
from fmus.origin import read_origin
from fmus.ssp.system import SspSystem
from fmus.variables import load_table

Ssp = Literal["1.0", "2.0"]
FMI: dict[Ssp, Fmi] = {"1.0": "2", "2.0": "3"}  # of the components
PARAMETER_SET = "initialValues"  # the one that libcosim applies unasked
STOP_S = 1.0
_NAMESPACE = "http://ssp-standard.org/SSP1/SystemStructure"
_SPACES = {
    "ssc": f"{_NAMESPACE}Common",
    "ssd": f"{_NAMESPACE}Description",
    "ssv": f"{_NAMESPACE}ParameterValues",
}
_TYPE: dict[Ssp, str] = {"1.0": "Real", "2.0": "Float64"}


def render_ssd(system: SspSystem, version: Ssp, sources: Mapping[Model, str]) -> bytes:
    """The system's description.

    Args:
        system: what is connected.
        version: of SSP.
        sources: place of every model's FMU in the archive.
    """
    origin = read_origin()
    root = _root("ssd:SystemStructureDescription", version, system.name)
    root.set("description", system.description)
    for name in ("author", "copyright", "license"):
        root.set(name, getattr(origin, name))
    inner = ET.SubElement(root, "ssd:System", name=system.name)
    elements = ET.SubElement(inner, "ssd:Elements")
    for component in system.components:
        kind = "application/x-fmu-sharedlibrary"
        attributes = {"name": component.name, "type": kind, "source": sources[component.model]}
        element = ET.SubElement(elements, "ssd:Component", attributes)
        element.set("implementation", "CoSimulation")
        connectors = ET.SubElement(element, "ssd:Connectors")
        table = load_table(component.model)
        ends = [(c.output, "output") for c in system.connections if c.start == component.name]
        ends += [(name, "output") for name in component.shown]
        ends += [(c.input, "input") for c in system.connections if c.end == component.name]
        for name, direction in ends:
            connector = ET.SubElement(connectors, "ssd:Connector", name=name, kind=direction)
            ET.SubElement(connector, f"ssc:{_TYPE[version]}", unit=table[name].unit or "1")
        bindings = ET.SubElement(element, "ssd:ParameterBindings")
        values = ET.SubElement(
            ET.SubElement(bindings, "ssd:ParameterBinding"), "ssd:ParameterValues"
        )
        held = ET.SubElement(values, "ssv:ParameterSet", version=version, name=PARAMETER_SET)
        _add_parameters(held, version, component.values)
    connections = ET.SubElement(inner, "ssd:Connections")
    for start, output, end, entry in system.connections:
        ends = {"startElement": start, "startConnector": output, "endElement": end}
        ET.SubElement(connections, "ssd:Connection", ends, endConnector=entry)
    _add_units(root, system)
    ET.SubElement(root, "ssd:DefaultExperiment", startTime="0.0", stopTime=repr(STOP_S))
    return to_bytes(root)


def render_ssv(system: SspSystem, version: Ssp) -> bytes:
    """All parameters of a system by `component.name`, for importers that take them so."""
    root = _root("ssv:ParameterSet", version, PARAMETER_SET)
    values = {f"{c.name}.{name}": v for c in system.components for name, v in c.values.items()}
    _add_parameters(root, version, values)
    return to_bytes(root)


def _root(tag: str, version: Ssp, name: str) -> ET.Element:
    spaces = {f"xmlns:{prefix}": uri for prefix, uri in _SPACES.items()}
    return ET.Element(tag, spaces | {"version": version, "name": name})


def _add_parameters(held: ET.Element, version: Ssp, values: Mapping[str, float | bool]) -> None:
    parameters = ET.SubElement(held, "ssv:Parameters")
    for name, value in values.items():
        parameter = ET.SubElement(parameters, "ssv:Parameter", name=name)
        kind, text = _TYPE[version], repr(value)
        if isinstance(value, bool):
            kind, text = "Boolean", text.lower()
        ET.SubElement(parameter, f"ssv:{kind}", value=text)


def _add_units(root: ET.Element, system: SspSystem) -> None:
    tables = [load_table(component.model) for component in system.components]
    units = {unit.name: unit for table in tables for unit in table.units}
    listing = ET.SubElement(root, "ssd:Units")
    for unit in units.values():
        element = ET.SubElement(listing, "ssc:Unit", name=unit.name)
        ET.SubElement(element, "ssc:BaseUnit", {k: str(v) for k, v in unit.base.items()})
