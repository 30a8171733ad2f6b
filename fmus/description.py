"""Texts of the FMUs' archives: model descriptions, build descriptions, documentation, licence.

Only the markup lives here; what the variables are is `fmus.variables`.
"""

import html
import importlib.metadata
import math
import re
from string import Template
from typing import NamedTuple
from xml.etree import ElementTree as ET

from fmus.compiler import PLAIN_NAMES, SAME_BITS, unit_file
from fmus.models import Fmi, read_text
from fmus.variables import TIME_REFERENCE, Table, Variable

LOG_CATEGORY = "logStatusError"
# Fig. 7 shows the first seconds of the motor's response. A turn at its speed takes 9 ms.
DEFAULT_STOP_S, DEFAULT_STEP_S = 2.0, 1e-3

_INITIAL = {
    "output": "calculated",
    "parameter": "exact",
    "structuralParameter": "exact",
    "local": "calculated",
}
_ENUMERATION = "Solver"


class Origin(NamedTuple):
    """Origin of the FMU; fields are named as the model descriptions' attributes.

    Attributes:
        version: of this project.
        author: holder of the copyright.
        copyright: the licence's line of it.
        license: SPDX name of the licence.
    """

    version: str
    author: str
    copyright: str
    license: str


def license_text() -> str:
    """The licence in full."""
    return str(importlib.metadata.distribution("minirobots").read_text("licenses/LICENSE"))


def read_origin() -> Origin:
    """Origin of the FMU, from the project's metadata and licence."""
    project = importlib.metadata.distribution("minirobots")
    (line,) = re.findall(r"^Copyright .*$", license_text(), re.MULTILINE)
    author = re.sub(r"^Copyright \(c\) \d+ ", "", line)
    return Origin(project.version, author, line, project.metadata["License-Expression"])


def render_fmi3(table: Table, token: str, origin: Origin) -> bytes:
    """`modelDescription.xml` of FMI 3.0.

    Args:
        table: the variables.
        token: instantiation token that ties the description to its binary.
        origin: whose work of which version the FMU is.
    """
    root = _root(table, origin, fmiVersion="3.0", instantiationToken=token)
    capabilities = {
        "modelIdentifier": table.name,
        "canGetAndSetFMUState": "true",
        "canSerializeFMUState": "true",
        "canHandleVariableCommunicationStepSize": "true",
    }
    ET.SubElement(root, "CoSimulation", capabilities)
    _add_units(root, table)
    if enumerations := table.group("parameter", "Enumeration"):
        definitions = ET.SubElement(root, "TypeDefinitions")
        for variable in enumerations:
            element = ET.SubElement(definitions, "EnumerationType", name=_ENUMERATION)
            _add_items(element, variable)
    _add_frame(root)
    variables = ET.SubElement(root, "ModelVariables")
    sizes_first = sorted(table.variables, key=lambda v: v.causality != "structuralParameter")
    for variable in sizes_first:  # some importers know no later dimension
        attributes = _identity(variable) | _values(variable)
        element = ET.SubElement(variables, variable.type, attributes)
        sizes = [table[name] for name in variable.dimensions]
        for size in sizes:
            ET.SubElement(element, "Dimension", valueReference=str(size.reference))
        if variable.start is not None:
            count = math.prod(int(size.start or 0) for size in sizes)
            element.set("start", " ".join([attributes["start"]] * count))
    ET.SubElement(variables, "Float64", _time() | {"unit": "s"})
    structure = ET.SubElement(root, "ModelStructure")
    for name in ("Output", "InitialUnknown"):
        for variable in table.group("output"):
            attributes = {"valueReference": str(variable.reference)}
            attributes["dependencies"] = _dependencies(table, variable, name != "Output")
            ET.SubElement(structure, name, attributes)
    return _to_bytes(root)


def render_fmi2(table: Table, token: str, origin: Origin) -> bytes:
    """`modelDescription.xml` of FMI 2.0.

    Args:
        table: the variables.
        token: GUID that ties the description to its binary.
        origin: whose work of which version the FMU is.
    """
    root = _root(table, origin, fmiVersion="2.0", guid=token)
    capabilities = {
        "modelIdentifier": table.name,
        "canNotUseMemoryManagementFunctions": "true",
        "canGetAndSetFMUstate": "true",
        "canSerializeFMUstate": "true",
        "canHandleVariableCommunicationStepSize": "true",
    }
    interface = ET.SubElement(root, "CoSimulation", capabilities)
    listing = ET.SubElement(interface, "SourceFiles")
    ET.SubElement(listing, "File", name=unit_file(table.name, "2"))
    _add_units(root, table)
    if enumerations := table.group("parameter", "Enumeration"):
        definitions = ET.SubElement(root, "TypeDefinitions")
        for variable in enumerations:
            element = ET.SubElement(definitions, "SimpleType", name=_ENUMERATION)
            _add_items(ET.SubElement(element, "Enumeration"), variable)
    _add_frame(root)
    # FMI 2 counts variables from 1, as the table's value references do; the time needs no variable.
    variables = ET.SubElement(root, "ModelVariables")
    for variable in table.variables:
        scalar = ET.SubElement(variables, "ScalarVariable", _identity(variable))
        ET.SubElement(scalar, variable.type.replace("Float64", "Real"), _values(variable))
    structure = ET.SubElement(root, "ModelStructure")
    for name in ("Outputs", "InitialUnknowns"):
        listing = ET.SubElement(structure, name)
        for variable in table.group("output"):
            attributes = {"index": str(variable.reference)}
            attributes["dependencies"] = _dependencies(table, variable, name != "Outputs")
            ET.SubElement(listing, "Unknown", attributes)
    return _to_bytes(root)


def render_build_description(table: Table, fmi: Fmi) -> bytes:
    """`buildDescription.xml`, by which importers compile the sources; FMI 2.0 takes FMI 3.0's.

    Args:
        table: the variables.
        fmi: standard of the FMU.
    """
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    definition = {
        "name": PLAIN_NAMES[fmi],
        "value": "1",
        "optional": "true",
        "description": f"for a shared library; without it {table.name}_ precedes every function",
    }
    build = ET.SubElement(root, "BuildConfiguration", modelIdentifier=table.name)
    options = {"compiler": "gcc", "compilerOptions": SAME_BITS}
    files = ET.SubElement(build, "SourceFileSet", options, language="C11")
    ET.SubElement(files, "SourceFile", name=unit_file(table.name, fmi))
    ET.SubElement(files, "PreprocessorDefinition", definition)
    return _to_bytes(root)


def _root(table: Table, origin: Origin, **attributes: str) -> ET.Element:
    return ET.Element(
        "fmiModelDescription",
        origin._asdict()
        | {
            "modelName": table.name,
            "description": table.description,
            "generationTool": "fmus.build",
            "variableNamingConvention": "structured",
        }
        | attributes,
    )


def _add_units(root: ET.Element, table: Table) -> None:
    definitions = ET.SubElement(root, "UnitDefinitions")
    for unit in table.units:
        element = ET.SubElement(definitions, "Unit", name=unit.name)
        ET.SubElement(element, "BaseUnit", {k: str(v) for k, v in unit.base.items()})
        for name, factor in unit.display.items():
            ET.SubElement(element, "DisplayUnit", name=name, factor=repr(factor))


def _add_items(element: ET.Element, variable: Variable) -> None:
    for value, (name, description) in enumerate(variable.items, start=1):
        ET.SubElement(element, "Item", name=name, value=str(value), description=description)


def _add_frame(root: ET.Element) -> None:
    categories = ET.SubElement(root, "LogCategories")
    ET.SubElement(categories, "Category", name=LOG_CATEGORY, description="refused calls")
    ET.SubElement(
        root,
        "DefaultExperiment",
        startTime="0",
        stopTime=repr(DEFAULT_STOP_S),
        stepSize=repr(DEFAULT_STEP_S),
    )


def _time() -> dict[str, str]:
    return {
        "name": "time",
        "valueReference": str(TIME_REFERENCE),
        "causality": "independent",
        "variability": "continuous",
    }


def _identity(variable: Variable) -> dict[str, str]:
    attributes = {
        "name": variable.name,
        "valueReference": str(variable.reference),
        "description": variable.description,
        "causality": variable.causality,
        "variability": _variability(variable),
    }
    if initial := _INITIAL.get(variable.causality):
        attributes["initial"] = initial
    return attributes


def _variability(variable: Variable) -> str:
    if variable.causality in {"parameter", "structuralParameter"}:
        return "tunable" if variable.tunable else "fixed"
    return "continuous" if variable.type == "Float64" else "discrete"


def _values(variable: Variable) -> dict[str, str]:
    attributes = {}
    if variable.type == "Enumeration":
        attributes |= {"declaredType": _ENUMERATION, "min": "1", "max": str(len(variable.items))}
    if variable.unit is not None:
        attributes["unit"] = variable.unit
    if variable.display_unit is not None:
        attributes["displayUnit"] = variable.display_unit
    for name in ("min", "max", "nominal"):
        if (value := getattr(variable, name)) is not None:
            attributes[name] = repr(value)
    if (start := variable.start) is not None:
        attributes["start"] = str(start).lower() if isinstance(start, bool) else repr(start)
    return attributes


def _dependencies(table: Table, variable: Variable, initial: bool) -> str:
    names = (*variable.depends, *(variable.parameters if initial else ()))
    return " ".join(map(str, sorted(table[name].reference for name in names)))


def _to_bytes(root: ET.Element) -> bytes:
    """A document as a file's content, the same for equal documents."""
    ET.indent(root)
    return ET.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"


def render_html(table: Table) -> bytes:
    """`documentation/index.html` of the archive.

    Args:
        table: the variables.
    """
    template = Template(read_text(table.name, "documentation.html"))
    rows = "\n".join(_html_row(variable) for variable in table.variables)
    values = {
        "name": table.name,
        "description": table.description,
        "rows": rows,
        "more": read_text(table.name, f"{table.name}.html"),
    }
    return template.substitute(values).encode()


def _html_row(variable: Variable) -> str:
    def limit(value: float | None) -> str:
        return "" if value is None else f"{value:g}"

    cells = (
        variable.name,
        variable.causality,
        variable.unit or variable.type,
        "" if variable.start is None else f"{variable.start}",
        limit(variable.min),
        limit(variable.max),
        variable.description,
    )
    return "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in cells) + "</tr>"
