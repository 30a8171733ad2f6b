"""The files beside a model description that describe an FMU: terminals, and how to compile it."""

from xml.etree import ElementTree as ET

from fmus.compiler import PLAIN_NAMES, SAME_BITS, unit_file
from fmus.description import to_bytes
from fmus.models import Fmi
from fmus.variables import Table


def render_terminals(table: Table) -> bytes:
    """`terminalsAndIcons.xml` of FMI 3.0.

    Args:
        table: the variables.

    Raises:
        KeyError: a terminal names an unknown variable.
    """
    root = ET.Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    picture = ET.SubElement(root, "GraphicalRepresentation")
    box = {"x1": "-100", "y1": "-100", "x2": "100", "y2": "100"}
    ET.SubElement(picture, "CoordinateSystem", box, suggestedScalingFactorTo_mm="0.1")
    ET.SubElement(picture, "Icon", box)
    listing = ET.SubElement(root, "Terminals")
    for name, members in table.terminals.items():
        terminal = ET.SubElement(listing, "Terminal", name=name, matchingRule="plug")
        for member, variable in members.items():
            kind = table[variable].causality
            ET.SubElement(
                terminal,
                "TerminalMemberVariable",
                variableName=variable,
                memberName=member,
                variableKind="signal" if kind in {"input", "output"} else kind,
            )
    return to_bytes(root)


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
    return to_bytes(root)
