"""Systems from files of SSP 1.0 and 2.0: an archive (.ssp), or its description alone (.ssd).

Systems in systems are taken apart: what remains are components, named by their place such as
"axle.left", and connections from component to component.
"""

import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote, urlsplit
from xml.etree.ElementTree import Element, fromstring

from cosim.base.reading import Kind, parsing, require_file
from cosim.fmi.archive import require_plain, unpack
from cosim.fmi.fmu import Fmu
from cosim.system.graph import Component, Connection, GraphError
from cosim.system.parameters import Value, bound_values, children, linear, start_text

DESCRIPTION = "SystemStructure.ssd"
_FMU = "application/x-fmu-sharedlibrary"
_SYSTEM_FILE = Kind("system file", "export it as SSP 1.0 or 2.0 (.ssp or .ssd)", GraphError)
Connector = tuple[str, str]  # place of an element, and name


class SystemFile(NamedTuple):
    """What a file says about a system.

    Attributes:
        components: in the order of the file.
        connections: between them.
        start_s, stop_s: of its default experiment, in s; None if it does not say.
    """

    components: list[Component]
    connections: list[Connection]
    start_s: float | None
    stop_s: float | None


class _Wire(NamedTuple):
    """A connection as it stands in the file, in the direction in which values go."""

    target: Connector
    factor: float
    offset: float
    convert: bool


def read_system(path: Path) -> SystemFile:
    """Read an .ssp or .ssd file.

    Raises:
        GraphError: it is none, or has in it what is not supported.
        FmuError: an FMU cannot be read.
        OSError: the file cannot be read.
    """
    try:
        return _Reader(path).result()
    except ValueError as error:  # of a number in it
        raise GraphError(f"{path}: {error}; {_SYSTEM_FILE.mend}") from error


class _Reader:
    def __init__(self, path: Path) -> None:
        self._path = path
        require_file(path, _SYSTEM_FILE)
        with parsing(path, _SYSTEM_FILE):
            self._folder, description = path.parent, path
            if zipfile.is_zipfile(path):
                self._folder = unpack(path, (DESCRIPTION, "resources/"))
                description = self._folder / DESCRIPTION
            self._root = _parsed(description)
        self._fmus: dict[Path, Fmu] = {}
        self._components: dict[str, Component] = {}
        self._kinds: dict[Connector, str] = {}  # of connectors, where declared
        self._wires: dict[Connector, list[_Wire]] = {}

    def result(self) -> SystemFile:
        systems = list(children(self._root, "System"))
        if len(systems) != 1:
            raise GraphError(f"{self._path}: it has no system; {_SYSTEM_FILE.mend}")
        self._read_system(systems[0], "", {})
        times = {}
        for experiment in children(self._root, "DefaultExperiment"):
            times = {k: float(v) for k, v in experiment.items() if k in ("startTime", "stopTime")}
        return SystemFile(
            list(self._components.values()),
            list(self._connections()),
            times.get("startTime"),
            times.get("stopTime"),
        )

    def _read_system(self, system: Element, place: str, above: dict[str, Value]) -> None:
        """Take in a system at a place, "" for the outermost; values from `above` go first."""
        said = f"{self._path}: system {place or system.get('name', '')}"
        if next(children(system, "SignalDictionaries", "SignalDictionary"), None) is not None:
            raise GraphError(f"{said} has a signal dictionary; connect components directly")
        values = bound_values(system, self._read, said) | above
        self._note_connectors(system, place)
        for elements in children(system, "Elements"):
            for element in elements:
                name = _joined(place, element.get("name", ""))
                inner = {
                    key.removeprefix(f"{element.get('name')}."): value
                    for key, value in values.items()
                    if key.startswith(f"{element.get('name')}.")
                }
                if element.tag.endswith("}System"):
                    self._read_system(element, name, inner)
                else:
                    self._read_component(element, name, inner)
        for connection in children(system, "Connections", "Connection"):
            self._read_connection(connection, place)

    def _note_connectors(self, element: Element, place: str) -> None:
        for connector in children(element, "Connectors", "Connector"):
            self._kinds[place, connector.get("name", "")] = connector.get("kind", "")

    def _read_component(self, element: Element, name: str, above: dict[str, Value]) -> None:
        said = f"{self._path}: component {name}"
        kind = element.get("type", _FMU)
        if not element.tag.endswith("}Component") or kind != _FMU:
            raise GraphError(f"{said} is of type {kind}; put FMUs in its place")
        if element.get("implementation", "any") not in ("any", "CoSimulation"):
            raise GraphError(f"{said} is for Model Exchange; export it for Co-Simulation")
        if name in self._components:
            raise GraphError(f"{said} stands there twice; rename one")
        path = self._resolve(element.get("source", ""))
        fmu = self._fmus.setdefault(path, self._fmus.get(path) or Fmu(path))
        start = {
            key: start_text(value, fmu.variables[key], fmu.description, said)
            for key, value in (bound_values(element, self._read, said) | above).items()
            if key in fmu.variables  # SSP says to ignore others
        }
        self._note_connectors(element, name)
        self._components[name] = Component(name, fmu, start)

    def _read_connection(self, connection: Element, place: str) -> None:
        """Note a connection, whose direction connectors tell, not the words start and end."""
        ends: list[Connector] = []
        for side in ("start", "end"):
            element = connection.get(f"{side}Element")
            where = place if element is None else _joined(place, element)
            ends.append((where, connection.get(f"{side}Connector", "")))
        gives = {"input", "parameter"} if ends[0][0] == place else {"output", "calculatedParameter"}
        if self._kinds.get(ends[0], next(iter(gives))) not in gives:
            ends.reverse()
        source, target = ends
        said = f"{self._path}: connection {'.'.join(source)} -> {'.'.join(target)}"
        convert = connection.get("suppressUnitConversion", "false") not in ("true", "1")
        wire = _Wire(target, *linear(connection, said), convert)
        self._wires.setdefault(source, []).append(wire)

    def _connections(self) -> Iterator[Connection]:
        """From component to component, through the connectors of systems between them."""
        for source in list(self._wires):
            if source[0] in self._components:
                for wire in self._reached(source, ()):
                    ends = ".".join(source), ".".join(wire.target)
                    yield Connection(*ends, wire.factor, wire.offset, wire.convert)

    def _reached(self, source: Connector, passed: tuple[Connector, ...]) -> Iterator[_Wire]:
        if source in passed:
            raise GraphError(
                f"{self._path}: connectors of systems lead in a circle at {'.'.join(source)}; "
                "remove a connection"
            )
        for wire in self._wires.get(source, []):
            if wire.target[0] in self._components:
                yield wire
                continue
            for behind in self._reached(wire.target, (*passed, source)):
                yield behind._replace(
                    factor=behind.factor * wire.factor,
                    offset=behind.factor * wire.offset + behind.offset,
                    convert=behind.convert and wire.convert,
                )

    def _resolve(self, source: str) -> Path:
        """File by the name that the description has for it."""
        parts = urlsplit(source)
        path = (self._folder / unquote(parts.path)).resolve()
        inside = self._folder == self._path.parent or path.is_relative_to(self._folder.resolve())
        if parts.scheme not in ("", "file") or not source or not inside:
            raise GraphError(f"{self._path}: source '{source}' is no file in it; put the file in")
        return path

    def _read(self, source: str) -> Element:
        path = self._resolve(source)
        require_file(path, _SYSTEM_FILE)
        with parsing(path, _SYSTEM_FILE):
            return _parsed(path)


def _parsed(path: Path) -> Element:
    require_plain(path)
    return fromstring(path.read_bytes())


def _joined(place: str, name: str) -> str:
    return f"{place}.{name}" if place else name
