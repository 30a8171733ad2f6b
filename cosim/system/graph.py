"""Parts of a system: components and their connections; invalid ones are refused.

A variable is named "component.variable"; names of either may have points in them, too.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element, fromstring

import numpy as np
from fmpy.model_description import ModelVariable
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from cosim.base.arguments import taken
from cosim.base.errors import UserError, shown
from cosim.fmi.fmu import Fmu, FmuError
from cosim.fmi.units import UnitUse, conversion, unit_use

Node = tuple[str, str]  # component and variable
_CLASSES = {name: name for name in ("Boolean", "Enumeration", "String")}  # others are numbers
# Numbers in memory, by their types of FMI 3.0 and 2.0, as numpy names them.
DTYPES = {f"{sign}Int{8 * size}": f"{sign[:1].lower() or 'i'}{size}"
          for sign in ("", "U") for size in (1, 2, 4, 8)}  # fmt: skip
DTYPES |= {"Float64": "f8", "Float32": "f4", "Real": "f8", "Integer": "i4"}
# What a connection may set, by the causality of its source; parameters at initialisation only.
_TARGETS = {"output": ("input",), "calculatedParameter": ("input", "parameter")}


class GraphError(UserError):
    """Invalid system. The message names the component, variable or connection."""


class Component(NamedTuple):
    """An FMU in a system.

    Attributes:
        name: of its own, at most once in a system.
        fmu: the .fmu file, or what was read from it before.
        start: values of parameters, inputs and start values by the names of variables; texts as in
            XML are read by the variable's type, arrays are sequences or texts with spaces.
    """

    name: str
    fmu: Path | Fmu
    start: Mapping[str, Any] = {}


class Connection(NamedTuple):
    """An output that sets an input: target = factor · source + offset, in the target's unit.

    Attributes:
        source, target: "component.variable".
        factor, offset: behind the conversion of units.
        convert: whether units are converted; if not, they may be any.
        source_index, target_index: of an element of an array, from 1, one for each dimension; empty
            for a variable as a whole.
    """

    source: str
    target: str
    factor: float = 1.0
    offset: float = 0.0
    convert: bool = True
    source_index: tuple[int, ...] = ()
    target_index: tuple[int, ...] = ()


class Link(NamedTuple):
    """A checked `Connection`, with the conversion of units in factor and offset."""

    source: Node
    target: Node
    factor: float
    offset: float
    source_index: tuple[int, ...] = ()
    target_index: tuple[int, ...] = ()


def _require_each(name: str, given: Any, kind: type) -> None:
    if not (isinstance(given, list | tuple) and all(isinstance(part, kind) for part in given)):
        raise GraphError(f"{name} = {shown(given)}: give a list of {kind.__name__}")


def load_fmus(components: Sequence[Component]) -> dict[str, Fmu]:
    """The FMU of each component by its name; one that several have is read once.

    Raises:
        GraphError: there is no component, two have one name, an FMU allows one instance, or has
            a clock that ticks in time, and no Event Mode.
        FmuError: an FMU cannot be used.
    """
    _require_each("components", components, Component)
    if not components:
        raise GraphError("the system has no component; give it one")
    files: dict[Path | Fmu, Fmu] = {}
    found: dict[str, Fmu] = {}
    owners: dict[object, str] = {}  # of binaries, by content and by instantiation token
    for name, given, _ in components:
        at = given.path if isinstance(given, Fmu) else given
        path = taken(f"component {name}: fmu", at, Path, GraphError)
        if name in found:
            raise GraphError(f"two components are named {name}; rename one")
        try:
            made = given if isinstance(given, Fmu) else None
            fmu = files.get(given) or made or Fmu(path, exchange=None)
        except FmuError as error:
            raise FmuError(f"component {name}: {error}") from error
        found[name] = files[given] = fmu
        clocks = ticking_clocks(fmu)
        if clocks and not (fmu.exchange or fmu.interface.hasEventMode):
            raise GraphError(
                f"component {name}: {path} has the clock '{clocks[0].get('name')}' that ticks in "
                "time, and no Event Mode (hasEventMode); export it with one"
            )
        for identity in (fmu.folder, str(fmu.description.guid)):
            other = owners.setdefault(identity, name)
            if other != name and fmu.interface.canBeInstantiatedOnlyOncePerProcess:
                raise GraphError(
                    f"component {name}: {path} has canBeInstantiatedOnlyOncePerProcess, and "
                    f"component {other} is of the same FMU; export it without"
                )
    return found


def find(fmus: Mapping[str, Fmu], name: str) -> Node:
    """Component and variable of "component.variable".

    Raises:
        GraphError: there is none.
    """
    parts = name.split(".")
    split = [(".".join(parts[:k]), ".".join(parts[k:])) for k in range(len(parts) - 1, 0, -1)]
    ends = [(component, variable) for component, variable in split if component in fmus]
    for component, variable in ends:  # names have dots in them: the longest component counts
        if variable in fmus[component].variables:
            return component, variable
    if ends:
        component, variable = ends[0]
        raise GraphError(
            f"component {component} has no variable '{variable}'; its modelDescription.xml "
            "names those it has"
        )
    raise GraphError(f"'{name}' is not a variable of a component; components are {', '.join(fmus)}")


def ticking_clocks(fmu: Fmu) -> list[Element]:
    """Clocks of an FMU that tick in time, as in its modelDescription.xml, with intervals."""
    if all(v.intervalVariability in (None, "triggered") for v in fmu.variables.values()):
        return []
    clocks = fromstring((fmu.folder / "modelDescription.xml").read_bytes()).iterfind(".//Clock")
    return [each for each in clocks if each.get("intervalVariability", "triggered") != "triggered"]


def clocks_of(variable: ModelVariable) -> tuple[str, ...]:
    """Clocks that tick in time, while one of which a variable can be got and set; () if always."""
    clocks: Any = variable.clocks or ()  # which fmpy declares as their numbers
    return tuple(str(v.name) for v in clocks if v.intervalVariability != "triggered")


def outputs(fmus: Mapping[str, Fmu], *types: str, but: bool = False) -> list[Node]:
    """Outputs of some types, or of all but those, if they have a time at which they can be got."""
    return [
        (component, str(v.name))
        for component, fmu in fmus.items()
        for v in fmu.description.modelVariables
        if v.causality == "output" and (v.type in types) != but and (clocks_of(v) or not v.clocks)
    ]


def check_connections(fmus: Mapping[str, Fmu], connections: Iterable[Connection]) -> list[Link]:
    """Connections with their components and variables, in the order given.

    Raises:
        GraphError: one has an unknown end, goes from or to what is no output or input, joins types
            or units that do not match, or sets an input that another one sets.
    """
    _require_each("connections", connections, Connection)
    links: list[Link] = []
    set_before: dict[tuple[str, int, str], set[tuple[int, ...]]] = {}  # indices of inputs
    for connection in connections:
        source, target = find(fmus, connection.source), find(fmus, connection.target)
        said = f"connection {connection.source} -> {connection.target}"
        from_, to = (fmus[end[0]].variables[end[1]] for end in (source, target))
        if to.causality not in _TARGETS.get(str(from_.causality), ()):
            raise GraphError(
                f"{said}: they are of causality {from_.causality} and {to.causality}; connect an "
                "output to an input, or a calculatedParameter to an input or a parameter"
            )
        if to.type == "String" and connection.target_index:
            raise GraphError(f"{said}: elements of arrays of texts are not set; connect the array")
        # An alias has the value reference of its variable, in FMI 2.0 in one type.
        indices = set_before.setdefault((target[0], to.valueReference, str(to.type)), set())
        if indices & {(), connection.target_index} or (indices and not connection.target_index):
            raise GraphError(f"{said}: another connection sets this input; remove one")
        indices.add(connection.target_index)
        _check_types(said, from_, to)
        factor, offset = connection.factor, connection.offset
        if not (math.isfinite(factor) and math.isfinite(offset)):
            raise GraphError(f"{said}: factor {factor:g} and offset {offset:g} must be finite")
        if connection.convert:
            units = [unit_use(v, fmus[end[0]].description) for v, end in
                     ((from_, source), (to, target))]  # fmt: skip
            if (found := convert(said, *units)) != (1.0, 0.0):
                factor, offset = factor * found[0], factor * found[1] + offset
        if (factor, offset) != (1.0, 0.0) and to.type not in ("Real", "Float64", "Float32"):
            raise GraphError(
                f"{said}: values of type {to.type} cannot be scaled; remove the transformation"
            )
        links.append(Link(source, target, factor, offset, *connection[5:]))
    return links


def check_bonds(
    fmus: Mapping[str, Fmu], links: Sequence[Link], bonds: Iterable[Sequence[str]]
) -> list[tuple[Link, Link]]:
    """Return the connections of power bonds: that of the effort, and that of the flow.

    Args:
        fmus: by component.
        links: between components.
        bonds: inputs "component.variable" that take the effort and the flow.

    Raises:
        GraphError: an input has no connection of Float64 values, or the two do not lead from one
            component to another one and back.
    """
    found = []
    for names in bonds:
        said = f"power bond {'='.join(names)}"
        pair = [link for name in names for link in links if link.target == find(fmus, name)]
        plain = [
            link.factor and not (link.offset or link.source_index or link.target_index)
            and is_continuous(fmus, link) for link in pair
        ]  # fmt: skip
        ends = [(link.source[0], link.target[0]) for link in pair]
        if len(pair) != 2 or not all(plain) or ends[0] != ends[1][::-1] or len({*ends[0]}) < 2:
            raise GraphError(
                f"{said}: name the inputs of effort and of flow, of two connections back and forth "
                "between two components, of scalar continuous Float64 values without an offset"
            )
        effort, flow = pair
        found.append((effort, flow))
    return found


def _check_types(said: str, source: ModelVariable, target: ModelVariable) -> None:
    kinds = [_CLASSES.get(str(v.type), "number") for v in (source, target)]
    if kinds[0] != kinds[1] or not keeps(str(source.type), str(target.type)):
        raise GraphError(
            f"{said}: {source.type} does not fit into {target.type}; connect variables of one type"
        )


def keeps(source: str, target: str) -> bool:
    """Return whether every value of an FMI type is one of another, of any standard."""
    if source == target:
        return source not in ("Binary", "Clock")
    if source not in DTYPES or target not in DTYPES:
        return False
    rounded = source.endswith("Int64") and target.startswith(("Real", "Float"))
    return np.can_cast(DTYPES[source], DTYPES[target], "safe") and not rounded


def convert(said: str, source: UnitUse | None, target: UnitUse | None) -> tuple[float, float]:
    """Return factor and offset from one unit to another; 1 and 0 where one is unknown.

    Args:
        said: what the values are called in messages.
        source, target: units of the values, and of those wanted.

    Raises:
        GraphError: the units do not match.
    """
    if source is None or target is None:
        return 1.0, 0.0
    found = conversion(source, target)
    if found is None:
        if {source.difference, target.difference} == {True, False} and conversion(
            source._replace(difference=None), target._replace(difference=None)
        ):
            raise GraphError(
                f"{said}: one of {source.name} and {target.name} is a difference "
                "(relativeQuantity) and the other is not; connect two of one kind"
            )
        raise GraphError(
            f"{said}: units {source.name} and {target.name} do not match; connect variables of one "
            "quantity, with units that are defined"
        )
    return found


def links_in_loops(fmus: Mapping[str, Fmu], links: Sequence[Link]) -> list[Link]:
    """Return the connections that are part of an algebraic loop, in their order.

    Outputs depend on the inputs of their components that the modelDescription names, and on all of
    them where it names none.
    """
    into: dict[Node, list[int]] = {}
    for k, link in enumerate(links):
        into.setdefault(link.target, []).append(k)
    ends = [
        (before, k)
        for k, link in enumerate(links)
        for name in _passed_on(fmus[link.source[0]], link.source[1])
        for before in into.get((link.source[0], name), ())
    ]
    if not ends:
        return []
    rows, columns = np.array(ends).T
    graph = coo_array((np.ones(len(ends)), (rows, columns)), shape=(len(links), len(links)))
    _, part = connected_components(graph, connection="strong")
    found = {int(k) for k in columns[rows == columns]}
    found |= set(np.flatnonzero(np.bincount(part)[part] > 1).tolist())
    return [link for k, link in enumerate(links) if k in found]


def is_continuous(fmus: Mapping[str, Fmu], link: Link) -> bool:
    """Return whether a connection passes on float64 values that vary without jumps."""
    ends = [fmus[component].variables[name] for component, name in (link.source, link.target)]
    varying = all(
        v.variability not in ("discrete", "fixed", "tunable") and not v.clocks for v in ends
    )
    return varying and {str(v.type) for v in ends} <= {"Real", "Float64"}


def _passed_on(fmu: Fmu, output: str) -> list[str]:
    """Inputs on which an output depends at initialisation."""
    description = fmu.description
    for unknown in (*description.initialUnknowns, *description.outputs):
        variable = unknown.variable
        same = variable is not None and (
            variable.valueReference == fmu.variables[output].valueReference
        )
        if same and unknown.dependencies is not None:
            return [str(v.name) for v in unknown.dependencies if v.causality == "input"]
    return [name for name, v in fmu.variables.items() if v.causality == "input"]
