"""Texts of the FMUs' archives, made from the hand-written description of each model.

`VibrationMotor.xml` and `VibrationMotors.xml` are model descriptions of FMI 3.0 without version,
licence and token. `variables.h`, the description for FMI 2.0 and the table of the documentation
are made from them.
"""

import html
import importlib.metadata
import re
from string import Template
from xml.etree import ElementTree as ET

from fmus.compiler import PLAIN_NAMES, SAME_BITS, unit_file
from fmus.models import Fmi, Model, read_text


def license_text() -> str:
    """Return the licence in full."""
    return str(importlib.metadata.distribution("minirobots").read_text("licenses/LICENSE"))


def read_origin() -> dict[str, str]:
    """Return version, author, copyright and license (SPDX), as attributes of a description."""
    project = importlib.metadata.distribution("minirobots")
    (line,) = re.findall(r"^Copyright .*$", license_text(), re.MULTILINE)
    return {
        "version": project.version,
        "author": re.sub(r"^Copyright \(c\) \d+ ", "", line),
        "copyright": line,
        "license": project.metadata["License-Expression"],
    }


def read_description(model: Model) -> ET.Element:
    """Return the root of a model's hand-written description."""
    return ET.fromstring(read_text(model, f"{model}.xml"))


def variables_of(root: ET.Element) -> list[ET.Element]:
    """Return the variables of a description but the time, in the order of their references."""
    found = [v for v in root.iterfind("ModelVariables/*") if v.get("causality") != "independent"]
    return sorted(found, key=lambda variable: int(variable.attrib["valueReference"]))


def start_of(variable: ET.Element) -> float:
    """Return the start value of a variable, of its first element if it is an array."""
    text = variable.get("start", "0").split()[0]
    return float({"true": "1", "false": "0"}.get(text, text))


def render_header(model: Model, token: str) -> str:
    """Return `variables.h`: value references, start values, limits and the instantiation token."""
    variables = variables_of(read_description(model))

    def of(causality: str, *types: str) -> list[ET.Element]:
        wanted = types or ("Float64",)
        return [v for v in variables if v.get("causality") == causality and v.tag in wanted]

    def names(elements: list[ET.Element]) -> str:
        return ", ".join(v.attrib["name"] for v in elements)

    def array(name: str, values: list[float]) -> str:
        numbers = [repr(value).replace("inf", "INFINITY") for value in values]
        return f"static const double {name}[] = {{{', '.join(numbers)}}};"

    inputs, parameters = of("input"), of("parameter")
    structural = of("structuralParameter", "UInt64")
    whole = [*of("parameter", "Boolean"), *of("parameter", "Enumeration"), *structural]
    references = [f"VR_{v.attrib['name']} = {v.attrib['valueReference']}" for v in variables]
    tunable = ", ".join(str(v.get("variability") == "tunable").lower() for v in parameters)
    quoted = ", ".join(f'"{name}"' for name in ["time", *(v.attrib["name"] for v in variables)])
    lines = [
        f"/* Made from {model}.xml by fmus/description.py. */",
        "#ifndef VARIABLES_H",
        "#define VARIABLES_H",
        f'#define INSTANTIATION_TOKEN "{token}"',
        f"enum {{ {', '.join(['VR_time = 0', *references])} }};",
        f"enum {{ VARIABLE_COUNT = {1 + len(variables)} }};",
        *(
            f"enum {{ {name}_FIRST = {group[0].attrib['valueReference']}, "
            f"{name}_COUNT = {len(group)} }};"
            for name, group in (("INPUT", inputs), ("PARAMETER", parameters))
        ),
        f"#define INPUT_FIELDS double {names(inputs)};",
        f"#define PARAMETER_FIELDS double {names(parameters)};",
        *(f"enum {{ START_{v.attrib['name']} = {start_of(v):.0f} }};" for v in whole),
        *(
            f"enum {{ LEAST_{v.attrib['name']} = {v.get('min')}, "
            f"MOST_{v.attrib['name']} = {v.get('max')} }};"
            for v in structural
        ),
        array("input_start", [start_of(v) for v in inputs]),
        array("parameter_start", [start_of(v) for v in parameters]),
        array("parameter_min", [float(v.get("min", "-inf")) for v in parameters]),
        array("parameter_max", [float(v.get("max", "inf")) for v in parameters]),
        f"static const bool parameter_tunable[] = {{{tunable}}};",
        f"static const char *const variable_name[] = {{{quoted}}};",
        "#endif",
    ]
    return "\n".join(lines) + "\n"


def render_description(model: Model, fmi: Fmi, token: str) -> bytes:
    """Return `modelDescription.xml`, with a token that ties it to its binary."""
    root = read_description(model)
    root.attrib.update(read_origin())
    if fmi == "2":
        _to_fmi2(root, model)
    root.set("guid" if fmi == "2" else "instantiationToken", token)
    ET.indent(root)
    return ET.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"


def _to_fmi2(root: ET.Element, model: Model) -> None:
    """Turn a description for FMI 3.0 without arrays into one for FMI 2.0.

    FMI 2 counts variables from 1, as value references do; the time needs no variable.
    """
    root.set("fmiVersion", "2.0")
    interface, variables = root.find("CoSimulation"), root.find("ModelVariables")
    structure = root.find("ModelStructure")
    assert interface is not None and variables is not None and structure is not None
    interface.attrib = {
        name.replace("FMUState", "FMUstate"): value for name, value in interface.items()
    } | {"canNotUseMemoryManagementFunctions": "true"}
    files = ET.SubElement(interface, "SourceFiles")
    ET.SubElement(files, "File", name=unit_file(model, "2"))
    for definition in root.iterfind("TypeDefinitions/EnumerationType"):
        items = ET.Element("Enumeration")
        items[:] = definition[:]
        definition.tag, definition[:] = "SimpleType", [items]
    scalars = []
    for variable in variables_of(root):
        shared = ("name", "valueReference", "description", "causality", "variability", "initial")
        own = {name: value for name, value in variable.items() if name in shared}
        scalars.append(ET.Element("ScalarVariable", own))
        rest = {name: value for name, value in variable.items() if name not in shared}
        ET.SubElement(scalars[-1], variable.tag.replace("Float64", "Real"), rest)
    variables[:] = scalars
    unknowns = []
    for name, plural in (("Output", "Outputs"), ("InitialUnknown", "InitialUnknowns")):
        unknowns.append(ET.Element(plural))
        for unknown in structure.iterfind(name):
            attributes = {"index": unknown.attrib["valueReference"]}
            attributes["dependencies"] = unknown.attrib["dependencies"]
            ET.SubElement(unknowns[-1], "Unknown", attributes)
    structure[:] = unknowns


def render_build_description(model: Model, fmi: Fmi) -> bytes:
    """Return `buildDescription.xml`, by which importers compile the sources of either standard."""
    text = Template(read_text(model, "buildDescription.xml"))
    return text.substitute(
        model=model, flag=SAME_BITS, file=unit_file(model, fmi), macro=PLAIN_NAMES[fmi]
    ).encode()


def render_html(model: Model) -> bytes:
    """Return `documentation/index.html` of the archive."""
    root, rows = read_description(model), []
    for variable in variables_of(root):
        get = variable.get
        start = get("start", "").split()[:1]
        cells = [get("name"), get("causality"), get("unit", variable.tag), *(start or [""])]
        cells += [get("min", ""), get("max", ""), get("description")]
        rows.append("".join(f"<td>{html.escape(str(cell))}</td>" for cell in cells))
    template = Template(read_text(model, "documentation.html"))
    return template.substitute(
        name=model,
        description=root.get("description"),
        rows="\n".join(f"<tr>{row}</tr>" for row in rows),
        more=read_text(model, f"{model}.html"),
    ).encode()
