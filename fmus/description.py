"""Model description of the motor FMU as XML, rendered from the variable table.

Only the markup of the standards lives here; what the variables are is `fmus.variables`.
"""

from xml.etree import ElementTree as ET

from fmus.variables import TIME_REFERENCE, Table, Variable

LICENSE = "MIT"
LOG_CATEGORY = "logStatusError"
# Fig. 7 shows the first seconds of the motor's response.
DEFAULT_STOP_S = 2.0

_INITIAL = {"input": None, "output": "calculated", "parameter": "exact", "local": "calculated"}
_TYPE_NAME = "Solver"


def render_fmi3(table: Table, token: str) -> bytes:
    """`modelDescription.xml` of FMI 3.0.

    Args:
        table: the variables.
        token: instantiation token that ties the description to its binary.
    """
    root = ET.Element(
        "fmiModelDescription",
        fmiVersion="3.0",
        modelName=table.name,
        instantiationToken=token,
        description=table.description,
        license=LICENSE,
        generationTool="fmus.build",
        variableNamingConvention="structured",
    )
    ET.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=table.name,
        canHandleVariableCommunicationStepSize="true",
    )
    _add_units(root, table)
    _add_enumerations(root, table)
    categories = ET.SubElement(root, "LogCategories")
    ET.SubElement(categories, "Category", name=LOG_CATEGORY, description="refused calls")
    ET.SubElement(
        root,
        "DefaultExperiment",
        startTime="0",
        stopTime=repr(DEFAULT_STOP_S),
        stepSize=repr(table["step_size"].start),
    )
    variables = ET.SubElement(root, "ModelVariables")
    ET.SubElement(
        variables,
        "Float64",
        name="time",
        valueReference=str(TIME_REFERENCE),
        causality="independent",
        variability="continuous",
        unit="s",
    )
    for variable in table.variables:
        _add_variable(variables, variable, table)
    structure = ET.SubElement(root, "ModelStructure")
    for element in ("Output", "InitialUnknown"):
        for variable in table.group("output"):
            ET.SubElement(structure, element, valueReference=str(variable.reference))
    return _to_bytes(root)


def _add_units(root: ET.Element, table: Table) -> None:
    definitions = ET.SubElement(root, "UnitDefinitions")
    for unit in table.units:
        element = ET.SubElement(definitions, "Unit", name=unit.name)
        ET.SubElement(element, "BaseUnit", {k: str(v) for k, v in unit.base.items()})
        for name, factor in unit.display.items():
            ET.SubElement(element, "DisplayUnit", name=name, factor=repr(factor))


def _add_enumerations(root: ET.Element, table: Table) -> None:
    definitions = ET.SubElement(root, "TypeDefinitions")
    for variable in table.group("parameter", "Enumeration"):
        element = ET.SubElement(
            definitions, "EnumerationType", name=_TYPE_NAME, description=variable.description
        )
        for value, (name, description) in enumerate(variable.items, start=1):
            ET.SubElement(element, "Item", name=name, value=str(value), description=description)


def _add_variable(parent: ET.Element, variable: Variable, table: Table) -> None:
    fixed = variable.causality == "parameter"
    attributes = {
        "name": variable.name,
        "valueReference": str(variable.reference),
        "description": variable.description,
        "causality": variable.causality,
        "variability": "fixed" if fixed else "continuous",
    }
    if initial := _INITIAL[variable.causality]:
        attributes["initial"] = initial
    if variable.type == "Enumeration":
        attributes["declaredType"] = _TYPE_NAME
    if variable.unit is not None:
        attributes["unit"] = variable.unit
    for name in ("min", "max", "nominal"):
        if (value := getattr(variable, name)) is not None:
            attributes[name] = repr(value)
    if variable.start is not None:
        attributes["start"] = _literal(variable.start)
    ET.SubElement(parent, variable.type, attributes)


def _literal(value: float | bool | int) -> str:
    return str(value).lower() if isinstance(value, bool) else repr(value)


def _to_bytes(root: ET.Element) -> bytes:
    ET.indent(root)
    return ET.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"
