"""Systems from files of SSP 1.0 and 2.0: an archive (.ssp), or its description alone (.ssd).

Systems in systems are taken apart: what remains are components, named by their place such as
"axle.left", and connections from component to component.
"""

import zipfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote, urlsplit
from xml.etree.ElementTree import Element, fromstring

from cosim.base.reading import Kind, parsing, require_file
from cosim.fmi.archive import MAX_DESCRIPTION_BYTES, require_plain, unpack
from cosim.fmi.fmu import Fmu, FmuError
from cosim.fmi.units import UnitUse, base_unit, unit_use
from cosim.system.graph import Component, Connection, GraphError, convert
from cosim.system.ssp.parameters import (
    Value,
    bound_values,
    children,
    is_true,
    linear,
    start_value,
    units_of,
)
from cosim.system.ssp.schema import check, local_name

DESCRIPTION = "SystemStructure.ssd"
_FMU = "application/x-fmu-sharedlibrary"
_EXCHANGE = {"any": None, "CoSimulation": False, "ModelExchange": True}
_SYSTEM_FILE = Kind("system file", "export it as SSP 1.0 or 2.0 (.ssp or .ssd)", GraphError)
Connector = tuple[str, str]  # place of an element, and name
# Kinds of connectors with an element that takes or gives a value.
_TAKING = ("input", "parameter", "structuralParameter")
_GIVING = ("output", "calculatedParameter", "local")


class SystemFile(NamedTuple):
    """Content of a file about a system.

    Attributes:
        components: in the order of the file.
        connections: between them.
        entries: from inputs of the system to those of components, by their names.
        start_s, stop_s: of its default experiment, in s; None if it does not say.
        units: of inputs of the system that have one, by their names.
    """

    components: list[Component]
    connections: list[Connection]
    entries: list[Connection]
    start_s: float | None
    stop_s: float | None
    units: dict[str, UnitUse]


class _Wire(NamedTuple):
    """A connection of the file, in the direction of its values."""

    source: Connector
    source_index: tuple[int, ...]
    target_index: tuple[int, ...]
    factor: float
    offset: float
    convert: bool


class _Signal(NamedTuple):
    """Signal that arrives at a connector: factor · origin + offset.

    Attributes:
        origin: connector of a component, or a value that a parameter set has for one of a system.
        element: index in the array that the origin is, if any.
        unit: of what arrives, None if it is not known.
    """

    origin: Connector | Value
    element: tuple[int, ...]
    factor: float
    offset: float
    unit: UnitUse | None


def read_system(
    path: Path,
    *,
    lenient: bool = False,
    most_bytes: int = MAX_DESCRIPTION_BYTES,
    variant: str = DESCRIPTION,
) -> SystemFile:
    """Read an .ssp or .ssd file.

    Args:
        path: of the file.
        lenient, most_bytes: how FMUs are read, see `Fmu`.
        variant: description in an archive, of which it can have several.

    Raises:
        GraphError: it is none, or has in it what is not supported.
        FmuError: an FMU cannot be read.
        OSError: the file cannot be read.
    """
    try:
        load = partial(Fmu, lenient=lenient, most_bytes=most_bytes)
        return _Reader(path, load, variant).result()
    except ValueError as error:  # of a number in it
        raise GraphError(f"{path}: {error}; {_SYSTEM_FILE.fix}") from error


class _Reader:
    def __init__(self, path: Path, load: Callable[..., Fmu], variant: str) -> None:
        self._path, self._load = path, load
        require_file(path, _SYSTEM_FILE)
        with parsing(path, _SYSTEM_FILE):
            self._folder, description = path.parent, path
            if zipfile.is_zipfile(path):
                with zipfile.ZipFile(path) as archive:
                    known = [n for n in archive.namelist() if n.endswith(".ssd") and "/" not in n]
                if variant not in known:
                    raise GraphError(f"{path} has no {variant}; choose from {', '.join(known)}")
                self._folder = unpack(path, (variant, "resources/"))
                description = self._folder / variant
            elif variant != DESCRIPTION:
                raise GraphError(
                    f"{path} is not an archive with variants; name the .ssd file itself"
                )
            self._root = _parsed(description, str(path))
            self._units = units_of(self._root)
        self._fmus: dict[tuple[Path, str], Fmu] = {}
        self._components: dict[str, Fmu] = {}
        self._given: dict[str, dict[str, Value]] = {}  # start values of components
        self._connectors: dict[Connector, Element] = {}  # where declared
        self._held: dict[Connector, Value] = {}  # values of connectors of systems
        self._wires: dict[Connector, list[_Wire]] = {}  # by their target
        # What arrives at connectors of systems: from a component, and a value.
        self._signals: dict[Connector, tuple[_Signal | None, _Signal | None]] = {}

    def result(self) -> SystemFile:
        systems = list(children(self._root, "System"))
        if len(systems) != 1:
            raise GraphError(f"{self._path}: it has no system; {_SYSTEM_FILE.fix}")
        self._read_system(systems[0], "", {}, 0)
        connections, entries = [], []
        for each in self._connections():
            if each.source.startswith("."):  # of no component
                entries.append(each._replace(source=each.source[1:]))
            else:
                connections.append(each)
        times = {}
        for experiment in children(self._root, "DefaultExperiment"):
            times = {k: float(v) for k, v in experiment.items() if k in ("startTime", "stopTime")}
        components = []
        for name, fmu in self._components.items():
            said = f"{self._path}: component {name}"
            start = {
                key: start_value(value, fmu.variables[key], fmu.description, said)
                for key, value in self._given[name].items()
            }
            components.append(Component(name, fmu, start))
        units = {
            name: unit
            for place, name in self._connectors
            if not place and (unit := self._declared_unit((place, name)))
        }
        ends = times.get("startTime"), times.get("stopTime")
        return SystemFile(components, connections, entries, *ends, units)

    def _read_system(
        self, system: Element, place: str, above: dict[str, Value], level: int
    ) -> None:
        """Take in a system at a place, "" for the outermost; values from `above` go first."""
        said = f"{self._path}: system {place or system.get('name', '')}"
        values = bound_values(system, self._read, said, level) | above
        self._note_connectors(system, place)
        for name, value in values.items():
            if (place, name) in self._connectors:
                if self._connectors[place, name].get("kind") not in _TAKING:
                    raise GraphError(
                        f"{said}: connector {name} is no input or parameter and takes no value; "
                        "give it to the component"
                    )
                self._held[place, name] = value
        elements = [element for listed in children(system, "Elements") for element in listed
                    if local_name(element) in ("System", "Component")]  # fmt: skip
        for element in elements:
            own = f"{element.get('name')}."
            inner = {k.removeprefix(own): v for k, v in values.items() if k.startswith(own)}
            name = _joined(place, element.get("name", ""))
            if local_name(element) == "System":
                self._read_system(element, name, inner, level + 1)
            else:
                self._read_component(element, name, inner, level + 1)
        names = {element.get("name", "") for element in elements}
        for connection in children(system, "Connections", "Connection"):
            self._read_connection(connection, place, names)

    def _note_connectors(self, element: Element, place: str) -> None:
        for connector in children(element, "Connectors", "Connector"):
            self._connectors[place, connector.get("name", "")] = connector

    def _read_component(
        self, element: Element, name: str, above: dict[str, Value], level: int
    ) -> None:
        said = f"{self._path}: component {name}"
        kind = element.get("type", _FMU)
        if kind != _FMU:
            raise GraphError(f"{said} is of type {kind}; put FMUs in its place")
        implementation = element.get("implementation", "any")
        if implementation not in _EXCHANGE:
            raise GraphError(f"{said} is for {implementation}; choose from {', '.join(_EXCHANGE)}")
        if name in self._components:
            raise GraphError(f"{said} appears twice; rename one")
        path = self._resolve(element.get("source", ""))
        if (path, implementation) not in self._fmus:
            try:
                fmu = self._load(path, exchange=_EXCHANGE[implementation])
            except FmuError as error:
                raise FmuError(f"component {name}: {error}") from error
            self._fmus[path, implementation] = fmu
        fmu = self._fmus[path, implementation]
        values = bound_values(element, self._read, said, level) | above
        # SSP says to ignore values for what the FMU does not have.
        self._given[name] = {key: v for key, v in values.items() if key in fmu.variables}
        self._note_connectors(element, name)
        self._components[name] = fmu

    def _read_connection(self, connection: Element, place: str, names: set[str]) -> None:
        """Note a connection; connectors define its direction, not the words start and end."""
        ends: list[tuple[Connector, tuple[int, ...]]] = []
        gives: list[bool] = []
        words = [connection.get(f"{side}{end}") for side in ("start", "end")
                 for end in ("Element", "Connector")]  # fmt: skip
        said = f"{self._path}: connection {_joined(*words[:2])} - {_joined(*words[2:])}"
        for side in ("start", "end"):
            element = connection.get(f"{side}Element")
            if element is not None and element not in names:
                raise GraphError(f"{said}: there is no element {element}; correct {side}Element")
            where = place if element is None else _joined(place, element)
            connector = where, connection.get(f"{side}Connector", "")
            index = tuple(map(int, connection.get(f"{side}Indices", "").split()))
            if index and where not in self._components:
                raise GraphError(
                    f"{said}: {side}Indices of a system's connector are not supported; connect "
                    "elements of a component's array"
                )
            ends.append((connector, index))
            kind = self._kind(connector, said)
            if kind not in _TAKING + _GIVING:
                raise GraphError(
                    f"{said}: {'.'.join(connector)} is of kind {kind}; connect inputs and outputs"
                )
            gives.append(kind in (_TAKING if element is None else _GIVING))
        if gives[0] == gives[1]:
            raise GraphError(
                f"{said}: {'none' if not gives[0] else 'each'} of them gives a value; connect an "
                "output and an input"
            )
        (source, source_index), (target, target_index) = ends if gives[0] else ends[::-1]
        convert = not is_true(connection, "suppressUnitConversion")
        wires = self._wires.setdefault(target, [])
        if wires and target[0] not in self._components:
            raise GraphError(f"{said}: another connection leads to {'.'.join(target)}; remove one")
        wires.append(_Wire(source, source_index, target_index, *linear(connection, said), convert))

    def _kind(self, connector: Connector, said: str) -> str:
        """Kind of a connector, which must be one of its FMU or declared."""
        place, name = connector
        declared = self._connectors.get(connector)
        if place not in self._components:
            if declared is None:
                raise GraphError(f"{said}: there is no connector {name}; correct its name")
            return declared.get("kind", "")
        variable = self._components[place].variables.get(name)
        if variable is None:
            raise GraphError(f"{said}: component {place} has no variable '{name}'; correct it")
        return str(variable.causality)

    def _connections(self) -> Iterator[Connection]:
        """To components; values for connectors of systems become start values."""
        for target, wires in self._wires.items():
            if target[0] not in self._components:
                continue
            for wire in wires:
                flow, held = self._through(wire, target)
                if flow is not None:
                    assert not isinstance(flow.origin, Value)
                    ends = ".".join(flow.origin), ".".join(target)
                    scale = flow.factor, flow.offset
                    yield Connection(*ends, *scale, False, flow.element, wire.target_index)
                if held is not None and isinstance(held.origin, Value):
                    said = f"{self._path}: value for {'.'.join(target)}"
                    if wire.target_index:
                        raise GraphError(f"{said}[…] of a system; give it to the component")
                    given, name = self._given[target[0]], target[1]
                    if name not in given or held.origin.level <= given[name].level:
                        value = held.origin.scaled(held.factor, held.offset, said)
                        given[name] = value._replace(unit=None)

    def _through(self, wire: _Wire, target: Connector) -> tuple[_Signal | None, _Signal | None]:
        """Return what arrives at the target of a wire."""
        flow = held = None
        if wire.source[0] not in self._components:
            flow, held = self._arriving(wire.source)
        else:
            flow = _Signal(wire.source, wire.source_index, 1.0, 0.0, self._own_unit(wire.source))
            if wire.convert:
                flow = self._converted(flow, self._declared_unit(wire.source), wire.source)
        return flow and self._passed(flow, wire, target), held and self._passed(held, wire, target)

    def _passed(self, signal: _Signal, wire: _Wire, target: Connector) -> _Signal:
        units = self._declared_unit(target), self._own_unit(target)
        if not wire.convert:
            signal = signal._replace(unit=None)
        for unit in units:
            signal = self._converted(signal, unit, target)
        factor, offset = wire.factor * signal.factor, wire.factor * signal.offset + wire.offset
        return signal._replace(factor=factor, offset=offset)

    def _own_unit(self, connector: Connector) -> UnitUse | None:
        """Unit of the variable of a component."""
        fmu = self._components.get(connector[0])
        return fmu and unit_use(fmu.variables[connector[1]], fmu.description)

    def _arriving(self, connector: Connector) -> tuple[_Signal | None, _Signal | None]:
        """Return what arrives at a connector of a system, by following wires backwards."""
        chain: dict[Connector, None] = {}
        at = connector
        while at not in self._signals and at[0] not in self._components:
            if at in chain:
                raise GraphError(
                    f"{self._path}: connectors of systems lead in a circle at {'.'.join(at)}; "
                    "remove a connection"
                )
            chain[at] = None
            if at not in self._wires:
                break
            at = self._wires[at][0].source
        for at in reversed(chain):
            flow = held = None
            for wire in self._wires.get(at, ()):
                flow, held = self._through(wire, at)
            if not at[0] and self._connectors[at].get("kind") == "input":  # of the whole system
                flow = _Signal(at, (), 1.0, 0.0, self._declared_unit(at))
            own = self._held.get(at)
            if own and not (held and isinstance(held.origin, Value)
                            and held.origin.level < own.level):  # fmt: skip
                held = _Signal(own, (), 1.0, 0.0, own.unit or self._declared_unit(at))
            self._signals[at] = flow, held
        return self._signals[connector]

    def _declared_unit(self, connector: Connector) -> UnitUse | None:
        """Unit that the description gives to a connector."""
        element = self._connectors.get(connector)
        for typed in element if element is not None else ():
            if name := typed.get("unit"):
                base = self._units.get(name)
                fmu = self._components.get(connector[0])
                known = base_unit(name, fmu.description) if fmu else None
                return base or UnitUse(name, known)
        return None

    def _converted(self, signal: _Signal, unit: UnitUse | None, connector: Connector) -> _Signal:
        if unit is None:
            return signal
        said = f"{self._path}: at connector {'.'.join(connector)}"
        factor, offset = convert(said, signal.unit, unit)
        if unit.difference is None and signal.unit is not None:
            unit = unit._replace(difference=signal.unit.difference)
        return signal._replace(
            factor=factor * signal.factor, offset=factor * signal.offset + offset, unit=unit
        )

    def _resolve(self, source: str) -> Path:
        """File by the name that the description has for it."""
        parts = urlsplit(source)
        path = (self._folder / unquote(parts.path)).resolve()
        inside = self._folder == self._path.parent or path.is_relative_to(self._folder.resolve())
        whole = not (parts.query or parts.fragment)
        if parts.scheme not in ("", "file") or not parts.path or not inside or not whole:
            raise GraphError(f"{self._path}: source '{source}' is not a file in it; add the file")
        return path

    def _read(self, source: str) -> Element:
        path = self._resolve(source)
        require_file(path, _SYSTEM_FILE)
        with parsing(path, _SYSTEM_FILE):
            return _parsed(path, f"{self._path}: {source}")


def _parsed(path: Path, said: str) -> Element:
    require_plain(path)
    root = fromstring(path.read_bytes())
    check(root, said)
    return root


def _joined(place: str | None, name: str | None) -> str:
    return f"{place}.{name}" if place else name or ""
