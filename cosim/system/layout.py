"""The values of a system in one block of memory, and tables of copies and calls.

The block begins with what is got from components (outputs that are connected or recorded); inputs
that are set follow. A getter or setter takes all variables of one type of a component in one call.
"""

import itertools
from collections import namedtuple
from collections.abc import Callable, Collection, Mapping, Sequence, Set
from typing import NamedTuple

import numpy as np

from cosim.system.graph import GraphError, Link, Node, clocks_of
from cosim.system.inputs import Input
from cosim.system.instance import Instance
from cosim.system.texts import TextTable

WORD = 8  # bytes; what every variable begins at a multiple of
MOST_BYTES = 2**28  # of all values: far above what systems exchange, far below what fills a machine
TYPES = ("f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8")  # of values, by their number
# Columns of `Tables.components`: addresses, then first and last + 1 rows of the other tables.
COLUMN = namedtuple(
    "COLUMN",
    "standard handle do_step get_state set_state ask enter_events update enter_steps events"
    " discrete first_set end_set first_get end_get first_copy end_copy first_real end_real"
    " first_single end_single steps_as first_start period ends",
)(*range(25))
# Columns of the other tables; in that of bonds outputs and inputs of both ends, and the residual
# energy, which outputs of the step before follow.
CALL = namedtuple("CALL", "function references count values size")(*range(5))
COPY = namedtuple("COPY", "source target source_type target_type number scaled")(*range(6))
FEED = namedtuple("FEED", "place kind first_row last_row row_now fed")(*range(6))
BOND = namedtuple("BOND", "output input energy")(0, 2, 4)
# Columns of the places of floats that are got, and bytes of one, by the function that gets them.
_DOUBLES = COLUMN.first_real, 8
_FLOATS = {"Real": _DOUBLES, "Float64": _DOUBLES, "Float32": (COLUMN.first_single, 4)}


# Names of variables by component, the function that exchanges them, and clocks that they need.
Groups = dict[str, dict[tuple[str, tuple[str, ...]], list[str]]]


class Place(NamedTuple):
    """Place of a variable's values.

    Attributes:
        offset: in bytes from the begin of the block.
        dtype: of a value, as numpy names it.
        shape: () of a scalar.
        truth: whether they are Boolean.
        texts: texts of the numbers, if any.
    """

    offset: int
    dtype: str
    shape: tuple[int, ...]
    truth: bool
    texts: TextTable | None = None

    @property
    def number(self) -> int:
        """Return how many values there are."""
        return int(np.prod(self.shape))

    @property
    def size(self) -> int:
        """Bytes of the values."""
        return self.number * np.dtype(self.dtype).itemsize

    def read(self, rows: np.ndarray) -> np.ndarray:
        """Values (n, *shape) of rows (n, bytes) of the block."""
        values = np.ascontiguousarray(rows[:, self.offset : self.offset + self.size])
        found = values.view(self.dtype).reshape(len(rows), *self.shape)
        if self.texts:
            return np.array(self.texts.known)[found]
        return found.astype(bool) if self.truth else found


class Memory(NamedTuple):
    """The block as arrays of floats, bytes, and words."""

    f8: np.ndarray
    f4: np.ndarray
    u1: np.ndarray
    i8: np.ndarray


class Tables(NamedTuple):
    """Tables of a system for compiled code; int64 unless said otherwise.

    Attributes:
        components: (C, columns); floats that are got are values first_real to end_real - 1 of the
            block as float64, first_single to end_single - 1 as float32; period is ticks of a step,
            ends is whether the last one asked to end.
        exchanges: (E, 5), getters and setters to call.
        copies: (K, 6), from outputs to inputs; places in multiples of the values' sizes.
        scales: (K, 2) float64, factor and offset.
        checked: (V, 2), indices of the first values of checked outputs, and their number.
        nominal: (V,) float64, their usual sizes.
        states: (3, C), saved states, of three points of time.
        counts: (C, 4): steps, rollbacks, ns spent where that is measured, warnings.
        room: (10,), for what calls write.
        feeds: (J, 6), inputs that are given over time, the rows of their values, and components.
        given: (2, R) float64, times in s and values.
        bonds: (B, 5), of power, see above; the first end takes the effort.
        weights: (B, 2) float64, units of the first end in one of the second end, nominal power.
    """

    components: np.ndarray
    exchanges: np.ndarray
    copies: np.ndarray
    scales: np.ndarray
    checked: np.ndarray
    nominal: np.ndarray
    states: np.ndarray
    counts: np.ndarray
    room: np.ndarray
    feeds: np.ndarray
    given: np.ndarray
    bonds: np.ndarray
    weights: np.ndarray


def energy_of(effort: Link) -> Node:
    """Return what the residual energy of a power bond is called."""
    return effort.target[0], f"{effort.target[1]} residual energy"


class Layout:
    """Memory and tables of instances and their links.

    Attributes:
        places: of every variable that is got or set.
        kept: variables that begin with the values they have: arrays with some elements set, and
            those that are tied to clocks.
        words: of what is got, at the begin of the block.
        memory: the block.
        tables: for compiled code.

    Raises:
        GraphError: a link joins arrays of different shapes, or a variable cannot be exchanged.
    """

    def __init__(
        self,
        instances: Mapping[str, Instance],
        links: Sequence[Link],
        recorded: Sequence[Node],
        checked: Sequence[Node],
        inputs: Sequence[Input],
        periods: Sequence[int],
        bonds: Sequence[tuple[Link, Link]],
    ) -> None:
        """Make both.

        Args:
            instances: by component, in the order in which they step.
            links: between them.
            recorded: variables that are got, too.
            checked: outputs of 64 bits with errors that matter, which are got, too.
            inputs: that are given over time.
            periods: ticks of a step of each instance.
            bonds: links of effort and flow with a recorded residual energy.
        """
        self._instances = instances
        self.kept = [link.target for link in links if link.target_index]
        self.places: dict[Node, Place] = {}
        self._texts = TextTable()
        self._end = 0
        got = dict.fromkeys([*(link.source for link in links), *recorded, *checked])
        gets = self._groups(list(got))
        for effort, _ in bonds:
            self.places[energy_of(effort)] = Place(self._end, "f8", (), False)
            self._end += 3 * WORD
        self.words = self._end // WORD
        targets = dict.fromkeys(link.target for link in links)
        fixed = [n for n in targets if instances[n[0]].fmu.variables[n[1]].causality != "input"]
        starts = self._groups(fixed)
        fed = [each.target for each in inputs]
        sets = self._groups([*(node for node in targets if node not in fixed), *fed])
        if self._end > MOST_BYTES:
            raise GraphError(
                f"the values of the system take {self._end >> 20} MiB, more than "
                f"{MOST_BYTES >> 20}; choose smaller dimensions, or fewer variables to record"
            )
        block = np.zeros(max(self._end, WORD), dtype=np.uint8)
        self.memory = Memory(*(block.view(dtype) for dtype in Memory._fields))
        self._references: list[np.ndarray] = []  # keeps what tables have addresses of
        names = list(instances)
        components = np.zeros((len(names), len(COLUMN)), dtype=np.int64)
        components[:, COLUMN.period] = periods
        exchanges: list[tuple[int, ...]] = []
        by_target = sorted(links, key=lambda link: names.index(link.target[0]))
        self.links = by_target
        at = COLUMN
        for row, (name, instance) in zip(components, instances.items(), strict=True):
            self._fill(row, instance)
            row[at.first_start] = len(exchanges)
            exchanges += self._calls("Set", name, starts).values()
            row[at.first_set] = len(exchanges)
            exchanges += self._calls("Set", name, sets).values()
            row[at.end_set] = row[at.first_get] = len(exchanges)
            exchanges += self._calls("Get", name, gets).values()
            row[at.end_get] = len(exchanges)
            mine = [k for k, link in enumerate(by_target) if link.target[0] == name]
            row[at.first_copy], row[at.end_copy] = (mine[0], mine[-1] + 1) if mine else (0, 0)
            mine = [v for group in sets.get(name, {}).values() for v in group]
            if instance.integration and mine:
                block = slice(*self._span(name, mine))
                instance.integration.inputs = self.memory.u1[block]
            for function, (first, width) in _FLOATS.items():
                found = [v for (own, _), group in gets.get(name, {}).items() for v in group
                         if own == function]  # fmt: skip
                if found:
                    row[first : first + 2] = np.array(self._span(name, found)) // width
            row[at.discrete] = any(
                v.variability == "discrete" and not v.clocks
                for v in (instance.fmu.variables[each] for each in mine)
            )
        self._clocked: list[tuple[str, str, tuple[str, ...], int]] = []
        for name, (verb, groups) in itertools.product(names, (("Set", sets), ("Get", gets))):
            for (_, clocks), call in self._calls(verb, name, groups, clocked=True).items():
                self._clocked.append((name, verb, clocks, len(exchanges)))
                exchanges.append(call)
        self.tables = Tables(
            components,
            np.array(exchanges, dtype=np.int64).reshape(-1, 5),
            np.array([self._copy(k) for k in by_target], dtype=np.int64).reshape(-1, 6),
            np.array([link[2:4] for link in by_target]).reshape(-1, 2),
            np.array([(self.places[n].offset // WORD, self.places[n].number) for n in checked],
                     dtype=np.int64).reshape(-1, 2),
            np.array([self.nominal(n) for n in checked]),
            np.zeros((3, len(names)), dtype=np.int64),
            np.zeros((len(names), 4), dtype=np.int64),
            np.zeros(10, dtype=np.int64),
            *self._feeds(inputs),
            np.array([self._bond(*bond) for bond in bonds], dtype=np.int64).reshape(-1, 5),
            np.array([(e.factor / f.factor, self.nominal(e.target) * self.nominal(f.source))
                      for e, f in bonds]).reshape(-1, 2),
        )  # fmt: skip

    def calls_at(self, component: str, clocks: Set[str]) -> list[tuple[int, int, int]]:
        """Number of a component, first and last + 1 of its calls where some of its clocks tick.

        Those that set are before those that get.
        """
        number = list(self._instances).index(component)
        row, at = self.tables.components[number].tolist(), COLUMN
        calls = [("Set", row[at.first_set], row[at.end_set]),
                 ("Get", row[at.first_get], row[at.end_get])]  # fmt: skip
        calls += [
            (verb, k, k + 1) for name, verb, own, k in self._clocked
            if name == component and not clocks.isdisjoint(own)
        ]  # fmt: skip
        return [(number, *ends) for _, *ends in sorted(calls, key=lambda call: call[0] == "Get")]

    def _bond(self, effort: Link, flow: Link) -> list[int]:
        """Row of `Tables.bonds`."""
        nodes = flow.source, effort.source, effort.target, flow.target, energy_of(effort)
        return [self.places[node].offset // WORD for node in nodes]

    def _groups(self, nodes: Sequence[Node]) -> Groups:
        """Variables by component, function and clocks, with their places behind the existing ones.

        Those of one function follow on each other, first those that are tied to no clock.
        """
        groups: Groups = {}
        for component, name in nodes:
            instance = self._instances[component]
            variable = instance.fmu.variables[name]
            kind, clocks = instance.kind(variable), clocks_of(variable)
            if kind is None:
                raise GraphError(
                    f"component {component}: '{name}' of type {variable.type} can be neither "
                    "recorded nor connected; choose numbers, Boolean, Enumeration or String"
                )
            if variable.clocks and not clocks:
                raise GraphError(
                    f"component {component}: '{name}' is tied to clocks that do not tick in time; "
                    "choose another variable"
                )
            if clocks and kind.function != "String":
                self.kept.append((component, name))
            groups.setdefault(component, {}).setdefault((kind.function, clocks), []).append(name)
        for component, found in groups.items():
            instance = self._instances[component]
            functions = [function for function, _ in found]
            order = sorted(found, key=lambda key, f=functions: (f.index(key[0]), key[1]))
            groups[component] = {key: found[key] for key in order}
            for name in itertools.chain.from_iterable(groups[component].values()):
                variable = instance.fmu.variables[name]
                kind = instance.kind(variable)
                assert kind is not None
                self._end += -self._end % np.dtype(kind.dtype).itemsize
                truth, text = (variable.type == each for each in ("Boolean", "String"))
                shape, texts = instance.shape(variable), self._texts if text else None
                place = Place(self._end, kind.dtype, shape, truth, texts)
                self.places[component, name] = place
                self._end += place.size
            self._end += -self._end % WORD
        return groups

    def _span(self, component: str, names: Sequence[str]) -> tuple[int, int]:
        """First byte of variables that follow on each other in the block, and that behind them."""
        first, last = (self.places[component, name] for name in (names[0], names[-1]))
        return first.offset, last.offset + last.size

    def _fill(self, row: np.ndarray, instance: Instance) -> None:
        at, exchange, standard = COLUMN, bool(instance.integration), instance.fmu.standard
        third = exchange or standard == 3
        row[at.standard], row[at.handle], row[at.events] = (
            standard,
            instance.handle,
            instance.events,
        )
        row[at.steps_as] = 2 + third
        row[at.do_step] = instance.address("DoStep")
        row[at.get_state] = instance.address("GetFMUState" if third else "GetFMUstate")
        row[at.set_state] = instance.address("SetFMUState" if third else "SetFMUstate")
        if third:
            row[at.enter_events] = instance.address("EnterEventMode")
            row[at.update] = instance.address("UpdateDiscreteStates")
            row[at.enter_steps] = instance.address(
                "EnterContinuousTimeMode" if exchange else "EnterStepMode"
            )
        else:
            row[at.ask] = instance.address("GetBooleanStatus")

    def _calls(
        self, verb: str, component: str, groups: Groups, clocked: bool = False
    ) -> dict[tuple[str, tuple[str, ...]], tuple[int, ...]]:
        """Rows of `Tables.exchanges` of variables that are tied to clocks, or are not, by those."""
        return {
            key: self._call(verb, component, key[0], names)
            for key, names in groups.get(component, {}).items() if bool(key[1]) == clocked
        }  # fmt: skip

    def _call(self, verb: str, component: str, function: str, names: list[str]) -> tuple[int, ...]:
        """Row of `Tables.exchanges`."""
        instance = self._instances[component]
        variables = [instance.fmu.variables[name] for name in names]
        references = np.array([v.valueReference for v in variables], dtype=np.uint32)
        self._references.append(references)
        places = [self.places[component, name] for name in names]
        first, number = places[0].offset, sum(place.number for place in places)
        if function == "String":
            block = self.memory.i8[first // WORD : first // WORD + number]
            address = instance.text_address(verb, names, block, self._texts)
        else:
            address = instance.address(verb + function)
        values = self.memory.u1.ctypes.data + first
        return address, references.ctypes.data, len(references), values, number

    def feed(self, inputs: Sequence[Input]) -> None:
        """Replace the values of inputs that are given over time."""
        feeds, given = self._feeds(inputs)
        self.tables = self.tables._replace(feeds=feeds, given=given)

    def _feeds(self, inputs: Sequence[Input]) -> tuple[np.ndarray, np.ndarray]:
        """Tables of inputs that are given over time."""
        rows, end = [], 0
        for each in inputs:
            place = self.places[each.target]
            if place.shape:
                raise GraphError(
                    f"input {'.'.join(each.target)} is an array; inputs over time are scalars"
                )
            first, end = end, end + len(each.time_s)
            at = place.offset // np.dtype(place.dtype).itemsize
            number = list(self._instances).index(each.target[0])
            rows.append((at, TYPES.index(place.dtype), first, end - 1, first, number))
        given = [np.array([each.time_s, each.values]) for each in inputs]
        return (
            np.array(rows, dtype=np.int64).reshape(-1, 6),
            np.ascontiguousarray(np.concatenate([np.empty((2, 0)), *given], axis=1)),
        )

    def reader(self, nodes: Sequence[Node]) -> Callable[[], list[float]]:
        """Return a function that reads the present values of scalar variables.

        Raises:
            GraphError: one is an array.
        """
        where = []
        for node in nodes:
            place = self.places[node]
            if place.shape or place.texts:
                raise GraphError(f"{'.'.join(node)} is an array or text; choose numbers")
            array = self.memory.u1.view(place.dtype)
            where.append((array, place.offset // array.itemsize))
        return lambda: [float(array[k]) for array, k in where]

    def places_of(self, links: Collection[Link]) -> tuple[np.ndarray, np.ndarray]:
        """Places (H,) in the block of the inputs that some links set, all of type float64.

        And ticks (2, H) from one of their values to the next one that they are extrapolated by, and
        of a step of their components.
        """
        periods = dict(zip(self._instances, self.tables.components[:, COLUMN.period], strict=True))
        found = []
        for k, link in enumerate(self.links):
            own, put_out = (periods[end[0]] for end in (link.target, link.source))
            first = self.tables.copies[k, COPY.target]
            places = range(first, first + self.tables.copies[k, COPY.number] * (link in links))
            found += [(place, put_out if own % put_out else own, own) for place in places]
        rows = np.array(found, dtype=np.int64).reshape(-1, 3).T.copy()
        return rows[0], rows[1:]

    def node_at(self, byte: int) -> Node:
        """Variable with values at a byte of the block."""
        return next(n for n, p in self.places.items() if p.offset <= byte < p.offset + p.size)

    def _copy(self, link: Link) -> tuple[int, ...]:
        """Row of `Tables.copies`."""
        said = f"connection {'.'.join(link.source)} -> {'.'.join(link.target)}"
        source, first = self._part(link.source, link.source_index, said)
        target, second = self._part(link.target, link.target_index, said)
        if source.shape != target.shape:
            raise GraphError(
                f"{said}: shapes {source.shape} and {target.shape} do not match; connect arrays of "
                "one shape"
            )
        places = [
            p.offset // np.dtype(p.dtype).itemsize + k
            for p, k in ((source, first), (target, second))
        ]
        types = [TYPES.index(p.dtype) for p in (source, target)]
        scaled = (link.factor, link.offset) != (1.0, 0.0)
        return *places, *types, source.number, scaled

    def _part(self, node: Node, index: tuple[int, ...], said: str) -> tuple[Place, int]:
        """Place of a variable, and the number of an element, which has the place of a scalar."""
        place = self.places[node]
        if not index:
            return place, 0
        fits = len(index) == len(place.shape)
        if not fits or not all(1 <= k <= n for k, n in zip(index, place.shape, strict=True)):
            raise GraphError(
                f"{said}: {'.'.join(node)} of shape {place.shape} has no element {index}; indices "
                "are from 1, one for each dimension"
            )
        within = [k - 1 for k in index]
        return place._replace(shape=()), int(np.ravel_multi_index(within, place.shape))

    def nominal(self, node: Node) -> float:
        """Usual size of a variable."""
        variable = self._instances[node[0]].fmu.variables[node[1]]
        declared = variable.nominal or (variable.declaredType and variable.declaredType.nominal)
        return abs(float(declared or 1.0)) or 1.0
