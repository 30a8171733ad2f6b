"""Elements that are read of files of SSP 1.0 and 2.0; all others are refused by name."""

from xml.etree.ElementTree import Element

from cosim.system.graph import GraphError

MAX_DEPTH = 200  # of elements in elements: systems in systems have three elements per level
# Has no effect on what is simulated, wherever it is.
NO_EFFECT = {"Annotations", "ElementGeometry", "ConnectorGeometry", "ConnectionGeometry",
             "SystemGeometry", "GraphicalElements", "MetaData", "Signature"}  # fmt: skip
NOTES = {"id", "description", "author", "fileversion", "copyright", "license", "generationTool",
         "generationDateAndTime"}  # fmt: skip
_FLOATS = ("Real", "Float64", "Float32")
_INTEGERS = ("Integer", *(f"{sign}Int{bits}" for sign in ("", "U") for bits in (8, 16, 32, 64)))
_TYPES = " ".join((*_FLOATS, *_INTEGERS, "Boolean", "String", "Enumeration", "Binary"))
_TRANSFORMATION = "LinearTransformation"
# Attributes and elements that are read, by the name of the element that has them.
KNOWN = {
    name: (frozenset(attributes.split()), frozenset(elements.split()))
    for name, attributes, elements in (
        ("SystemStructureDescription", "version name", "System Enumerations Units"
         " DefaultExperiment"),
        ("System", "name", "Connectors ParameterBindings Elements Connections"),
        ("Elements", "", "Component System"),
        ("Component", "name type source implementation", "Connectors ParameterBindings"),
        ("Connectors", "", "Connector"),
        ("Connector", "name kind", f"{_TYPES} Dimension"),
        ("Dimension", "size sizeConnector", ""),
        ("Connections", "", "Connection"),
        ("Connection", "startElement startConnector startIndices endElement endConnector"
         " endIndices suppressUnitConversion", _TRANSFORMATION),
        (_TRANSFORMATION, "factor offset", ""),
        ("ParameterBindings", "", "ParameterBinding"),
        ("ParameterBinding", "type source sourceBase prefix", "ParameterValues ParameterMapping"),
        ("ParameterValues", "", "ParameterSet"),
        ("ParameterSet", "version name", "Parameters Enumerations Units"),
        ("Parameters", "", "Parameter"),
        ("Parameter", "name", f"{_TYPES} Dimension"),
        ("ParameterMapping", "type source sourceBase version", "ParameterMapping MappingEntry"),
        ("MappingEntry", "source target suppressUnitConversion", _TRANSFORMATION),
        ("Enumerations", "", "Enumeration"),
        ("Item", "name value", ""),
        ("Units", "", "Unit"),
        ("Unit", "name", "BaseUnit"),
        ("BaseUnit", "kg m s A K mol cd rad factor offset", ""),
        ("DefaultExperiment", "startTime stopTime", ""),
        *((name, "value unit", "") for name in _FLOATS),
        *((name, "value", "") for name in (*_INTEGERS, "Boolean")),
        ("String", "value", "Value"),
        ("Enumeration", "name value", "Value Item"),
        ("Binary", "value mime-type", "Value"),
        ("Value", "value", ""),
    )
}  # fmt: skip


def local_name(element: Element) -> str:
    """Name of an element without its namespace."""
    return element.tag.rpartition("}")[2]


def check(root: Element, said: str) -> None:
    """Refuse elements and attributes that are not read.

    Args:
        root: of a file.
        said: what the file is called in messages.

    Raises:
        GraphError: there is one, or elements are nested without bound.
    """
    name = local_name(root)
    if name not in KNOWN:
        raise GraphError(f"{said}: {name} is not a file of SSP 1.0 or 2.0; export it as one")
    version = root.get("version", "1.0")
    if not version.startswith(("1.", "2.")):
        raise GraphError(f"{said}: it is of SSP {version}; export it as SSP 1.0 or 2.0")
    left = [(root, 1)]
    while left:
        element, depth = left.pop()
        name = local_name(element)
        attributes, elements = KNOWN[name]
        for attribute in set(element.keys()) - attributes - NOTES:
            if not attribute.startswith("{"):  # such as xsi:schemaLocation
                raise GraphError(
                    f"{said}: attribute {attribute} of {name} is not supported; remove it"
                )
        if depth > MAX_DEPTH:
            raise GraphError(
                f"{said}: elements are nested more than {MAX_DEPTH} deep; have fewer systems in "
                "systems"
            )
        for child in element:
            inner = local_name(child)
            if inner in elements:
                left.append((child, depth + 1))
            elif inner not in NO_EFFECT:
                raise GraphError(f"{said}: {inner} in {name} is not supported; remove it")
