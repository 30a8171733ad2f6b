"""A system of FMUs that runs: made, initialised, stepped, and freed."""

import ctypes
import logging
import math
import os
import time
import weakref
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Literal, get_args

import numpy as np

from cosim.base.arguments import taken
from cosim.base.jit import uninterrupted
from cosim.base.progress import Progress, automatic, showing, silent
from cosim.fmi.abi import FMI_ERROR, FMI_FATAL, FMI_OK
from cosim.fmi.fmu import Fmu, FmuError, LogLevel, check_steps, function_address
from cosim.fmi.isolation import calling
from cosim.model.config import whole_ratio
from cosim.system.clocks import Clocks, check_clocks
from cosim.system.coupling import HOME, Z, begin, get_all, make_coupling, restore, save, settle
from cosim.system.graph import (
    Component,
    Connection,
    GraphError,
    Node,
    check_bonds,
    check_connections,
    find,
    is_continuous,
    links_in_loops,
    load_fmus,
    outputs,
)
from cosim.system.inputs import Given, check_inputs, check_values, sampled
from cosim.system.instance import Instance
from cosim.system.layout import Layout, energy_of
from cosim.system.result import Share, SystemRun
from cosim.system.step import ALGORITHM, COUNT, PHASE, STATUS, Scheme
from cosim.system.stepping import DONE, REJECTED, ROW, TICK, run_plain, run_steps

_LOG = logging.getLogger(__name__)
MasterAlgorithm = Literal["jacobi", "gauss-seidel", "extrapolated", "implicit"]
Loops = Literal["solve", "explicit"]
StepControl = Literal["error", "energy"]
ALGORITHMS = get_args(MasterAlgorithm)  # by their numbers
_TOLERANCE = 1e-10  # of what is solved for
_STEPS_AT_ONCE, _SLOW_STEPS_AT_ONCE = 200_000, 500  # where steps do not, and do call Python
_MOST_EXCHANGES = 1000  # of values at one point of time
ROWS_AT_ONCE = 4096
_LONGEST = 1 << 40  # ticks of a step, by default: any
_WHAT = PHASE._replace(
    setting="refuses its inputs", stepping="failed", getting="has no outputs",
    saving="cannot save its state", restoring="cannot restore its state",
    ticking="fails in Event Mode",
)  # fmt: skip


class System:
    """A system of FMUs, initialised at its start time; free it by `close` or as a context."""

    def __init__(
        self,
        components: Sequence[Component],
        connections: Sequence[Connection] = (),
        *,
        algorithm: MasterAlgorithm = "jacobi",
        step_s: float = 1e-3,
        tolerance: float | None = None,
        longest_step_s: float | None = None,
        start_s: float = 0.0,
        stop_s: float | None = None,
        record: Sequence[str] | None = None,
        event_mode: bool = False,
        profile: bool = False,
        loops: Loops = "solve",
        inputs: Mapping[str, Given] | None = None,
        fmu_log: LogLevel = "warnings",
        solver_tolerance: float = 1e-8,
        component_steps: Mapping[str, float] = {},
        power_bonds: Iterable[Sequence[str]] = (),
        step_control: StepControl = "error",
    ) -> None:
        """Make the components and initialise them.

        Args:
            components: in the order in which Gauss–Seidel steps them.
            connections: from outputs to inputs.
            algorithm: what inputs are during a step. "jacobi": outputs before the step;
                "gauss-seidel": the newest outputs, of components earlier in the list those after
                the step; of second order are "extrapolated": the mean of the values at both ends,
                of which the later one is extrapolated, and "implicit": the same, but steps are
                rolled back and repeated until the later one is the one that outputs then have.
            step_s: communication step in s; the shortest one if there is a tolerance.
            tolerance: of the error of one step in Float64 outputs, relative to the larger
                of a value and its nominal one; None for steps that are all equal.
            longest_step_s: with a tolerance, a multiple of `step_s`; by default any.
            start_s: simulated time at which it begins, in s.
            stop_s: last time that it will reach, in s, which FMUs are given; some need it.
            record: "component.variable" of what runs record; by default all outputs but texts.
            event_mode: whether FMUs that can (FMI 3.0, hasEventMode) leave their events to the
                master, and return early to do so.
            profile: whether to measure the time that each component takes.
            loops: whether algebraic loops are solved at every communication point, or values go
                around them once per step.
            inputs: values over time of inputs by "component.variable": times in s, which may not
                decrease, and values at them; or a function of an array of times in s that returns
                an array of values, of which those at multiples of `step_s` are used. Between
                times floats are interpolated linearly, others hold.
            fmu_log: "off" to have FMUs report nothing, "warnings" to log how many of their steps
                returned a warning, and "all" to print each of their messages, too.
            solver_tolerance: relative tolerance of CVODE, which integrates FMUs for Model Exchange;
                their states' nominal values times it are the absolute ones.
            component_steps: communication steps in s of single components, by their names; others
                have `step_s`. All are whole multiples of the shortest one.
            power_bonds: inputs of effort and of flow with a power as product, by two
                connections back and forth between two components. The energy that the coupling has
                added to both by then is recorded as "component.effort residual energy".
            step_control: what a tolerance bounds: "error", of outputs in a step, or "energy": the
                residual power of power bonds, relative to the larger of the most that has passed
                and the product of nominal values; no step is rolled back.

        Raises:
            GraphError: the system is invalid; the message names component, variable, connection.
            ConfigError: a step is no multiple of another one that it must be a multiple of.
            FmuError: an FMU cannot be used, or fails at the start.
            OSError: an FMU cannot be read.
        """
        for name, value, kind in (
            ("algorithm", algorithm, MasterAlgorithm), ("loops", loops, Loops),
            ("step_control", step_control, StepControl), ("fmu_log", fmu_log, LogLevel),
        ):  # fmt: skip
            taken(name, value, kind, GraphError)
        require_positive("step", step_s)
        require_positive("solver_tolerance", solver_tolerance)
        if tolerance is not None:
            require_positive("tolerance", tolerance)
        fmus = load_fmus(components)
        self._fmus, self._stop_s = fmus, stop_s
        links = check_connections(fmus, connections)
        bonds = check_bonds(fmus, links, power_bonds)
        by_energy = step_control == "energy"
        if by_energy and not (bonds and tolerance):
            raise GraphError("step control by energy needs power bonds and a tolerance; give both")
        steps_s = _steps_of(fmus, step_s, component_steps)
        tick_s = min(step_s, *steps_s.values())
        periods = [whole_ratio(f"step of {name}", each, "the shortest step", tick_s)
                   for name, each in steps_s.items()]  # fmt: skip
        self._ticks = whole_ratio("step", step_s, "the shortest step", tick_s)
        self._common = math.lcm(self._ticks, *periods)
        if self._common > 1 and (tolerance or bonds or algorithm == "implicit"):
            raise GraphError(
                "components have their own steps, which have one length and are not rolled back: "
                "leave the tolerance and power bonds out, and choose another algorithm than "
                "implicit"
            )
        number = ALGORITHMS.index(algorithm)
        clocked = check_clocks(
            fmus, fixed=self._common == 1 and not bonds,
            kept=not tolerance and number != ALGORITHM.implicit,
        )  # fmt: skip
        continuous = [link for link in links if is_continuous(fmus, link)]
        torn = continuous if number == ALGORITHM.implicit else []
        if loops == "solve" and number != ALGORITHM.implicit:
            looped = links_in_loops(fmus, links)
            torn = [link for link in continuous if link in looped]
            slow = [link for link in looped if steps_s[link.target[0]] > tick_s]
            if slow:
                raise GraphError(
                    f"component {slow[0].target[0]} has a step of its own and is in a loop through "
                    f"{'.'.join(slow[0].target)}; give all of the loop the shortest step, or pass "
                    "--loops explicit"
                )
        for name, fmu in fmus.items():
            said = f"FMU {fmu.path.name} of component {name}"
            fmu.warn(said)
            needs = "which a tolerance needs; leave the tolerance out"
            varied = needs if tolerance and not by_energy else None
            check_steps(fmu.interface, said, ("step", steps_s[name]), varied)
            if by_energy and not fmu.interface.canHandleVariableCommunicationStepSize:
                raise FmuError(
                    f"{said} cannot vary its step (canHandleVariableCommunicationStepSize), {needs}"
                )
            if number == ALGORITHM.implicit and not fmu.interface.canGetAndSetFMUstate:
                raise FmuError(
                    f"{said} cannot save its state (canGetAndSetFMUState), which --algorithm "
                    "implicit needs; choose extrapolated"
                )
        self._recorded = (
            outputs(fmus, "String", "Binary", "Clock", but=True)
            if record is None
            else list(dict.fromkeys(find(fmus, name) for name in record))
        )
        checked = outputs(fmus, "Real", "Float64") if tolerance else []
        longest = _LONGEST
        if longest_step_s is not None:
            require_positive("longest step", longest_step_s)
            if not tolerance:
                raise GraphError(
                    f"longest step {longest_step_s:g} has no effect without a tolerance; give one"
                )
            longest = whole_ratio("longest step", longest_step_s, "step", step_s)
        self._scheme = Scheme(
            number, start_s, tick_s, tolerance or 0.0, int(by_energy), longest, 1,
            _clock() if profile else 0, getattr(time, "CLOCK_MONOTONIC", 0), int(loops == "solve"),
            _MOST_EXCHANGES if loops == "solve" else len(links) + 1, _STEPS_AT_ONCE, _TOLERANCE,
            min(1e-2 * tolerance, 1e-6) if tolerance else _TOLERANCE,
        )  # fmt: skip
        self._inputs = check_inputs(fmus, links, inputs or {})
        self._now = np.array([0, 1, 0, 0, 0], dtype=np.int64)
        self._over = False
        self._instances: dict[str, Instance] = {}
        self._clocks: Clocks | None = None
        try:
            with calling("its initialisation"):
                for component in components:
                    fmu = fmus[component.name]
                    instance = Instance(
                        component, fmu, events=event_mode, fmu_log=fmu_log,
                        solver_tolerance=solver_tolerance,
                    )  # fmt: skip
                    self._instances[component.name] = instance
                if clocked:
                    self._clocks = Clocks(self._instances, start_s, tick_s)
                start = sampled(self._inputs, np.array([start_s]))
                layout = Layout(self._instances, links, self._recorded, checked, start, periods,
                                bonds)  # fmt: skip
                self._recorded += [energy_of(effort) for effort, _ in bonds]
                held = continuous if number >= ALGORITHM.extrapolated else []
                self._layout = layout
                if any(instance.functions for instance in self._instances.values()):
                    self._scheme = self._scheme._replace(at_once=_SLOW_STEPS_AT_ONCE)
                self._coupling = make_coupling(layout, held, torn)
                solved = number >= ALGORITHM.extrapolated or torn or tolerance or bonds
                self._steps = run_steps if solved else run_plain
                self._initialise([*layout.kept, *(link.target for link in torn)])
        except BaseException:
            self.close()
            raise
        self._finalizer = weakref.finalize(self, _free, self._instances, self._layout.tables.states)

    def _initialise(self, kept: Sequence[Node]) -> None:
        """Bring the instances to the start; inputs in `kept` begin with the values they have."""
        for instance in self._instances.values():
            instance.begin(self._scheme.start_s, self._stop_s, self._scheme.tolerance or None)
        layout = self._layout
        for component, name in kept:
            place, instance = layout.places[component, name], self._instances[component]
            values = instance.read(instance.fmu.variables[name]).astype(place.dtype)
            end = place.offset + place.size
            layout.memory.u1[place.offset : end] = values.view(np.uint8)
        block = layout.tables, layout.memory, self._coupling
        self._check(*get_all(*block[:2], 0))
        self._coupling.unknowns[Z] = layout.memory.f8[self._coupling.torn]
        self._check(*settle(*block, self._scheme))
        if self._clocks:
            self._clocks.begin()
        for instance in self._instances.values():
            instance.end_initialization()
        self._check(*begin(*block))
        if self._clocks:
            self._check(*self._clocks.tick(layout, self._coupling, self._scheme))
        self._over = any(instance.ends for instance in self._instances.values())

    @property
    def time_s(self) -> float:
        """Simulated time reached, in s."""
        if self._clocks and self._clocks.now > int(self._now[TICK]):  # it has failed within a step
            return self._clocks.time_s
        return self._scheme.start_s + int(self._now[TICK]) * self._scheme.tick_s

    @property
    def steps(self) -> int:
        """Communication steps accepted, of the shortest if components have steps of their own."""
        return int(self._now[DONE])

    @property
    def rejected(self) -> int:
        """Communication steps that were rolled back."""
        return int(self._now[REJECTED])

    @showing
    def run(
        self, until_s: float, *, every: int = 1, progress: Progress | None = automatic
    ) -> SystemRun:
        """Continue to a time; the first row is the present state.

        Args:
            until_s: time to reach, in s: a whole number of steps from the start.
            every: steps from one recorded row to the next; the last step has one, too.
            progress: receives how far the run is; by default it is shown on stderr if the run takes
                more than two seconds. None shows nothing.

        Raises:
            ConfigError: the time is no whole number of steps away.
            FmuError: an FMU failed; the message names it and the time.
        """
        if every < 1:
            raise GraphError(f"every {every} steps: choose 1 or more")
        every *= self._ticks
        scheme, layout = self._scheme._replace(every=every), self._layout
        duration_s = until_s - scheme.start_s
        require_positive("time to run", duration_s)
        whole = "step" if self._common == 1 else "a common multiple of all steps"
        common_s = self._common * scheme.tick_s
        until = self._common * whole_ratio("time to run to", duration_s, whole, common_s)
        if self._stop_s is not None and until_s > self._stop_s + 0.5 * scheme.tick_s:
            raise GraphError(f"stop_s = {self._stop_s:g} is before {until_s:g} s; make it later")
        if until <= self._now[TICK]:
            raise GraphError(f"the system is at {self.time_s:g} s; run it to a later time")
        asked = [name for name, instance in self._instances.items() if instance.ends]
        if self._finalizer.alive and asked and not self.steps:
            row = layout.memory.i8[None, : layout.words].copy()
            return self._result(self._now[[TICK]], row, f"{asked[0]} asked to end at the start")
        if not self._finalizer.alive or self._over:
            raise GraphError("the system has ended, failed or been closed; make it again")
        left = -(-(until - int(self._now[TICK])) // every) + 1
        ticks = [self._now[[TICK]]]
        rows = [layout.memory.i8[None, : layout.words].copy()]
        status, component = FMI_OK, 0
        while self._now[TICK] < until and status == FMI_OK:
            room = self._room(min(left, ROWS_AT_ONCE))
            status, component = self._go(scheme, self._feed(until), room)
            ticks.append(room[0][: self._now[ROW]])
            rows.append(room[1][: self._now[ROW]])
            (progress or silent)("simulating", self.time_s - scheme.start_s, duration_s)
        ended = None
        if status == STATUS.ended:
            ended = f"{list(self._instances)[component]} asked to end at {self.time_s:g} s"
        return self._result(np.concatenate(ticks), np.concatenate(rows), ended)

    def advance(self, steps: int) -> bool:
        """Make communication steps without recording.

        Args:
            steps: their number.

        Returns:
            False if an FMU has asked to end the simulation, else True.

        Raises:
            FmuError, GraphError: as `run`.
        """
        if not self._finalizer.alive or self._over:
            raise GraphError("the system has ended, failed or been closed; make it again")
        until = int(self._now[TICK]) + steps * self._ticks
        if until % self._common:
            raise GraphError(
                f"{steps} steps end within a step of a component; all steps have the common "
                f"multiple {self._common * self._scheme.tick_s:g} s"
            )
        scheme, room = self._scheme._replace(every=_LONGEST), self._room(2)
        while self._now[TICK] < until and not self._over:
            self._go(scheme, until, room)
        return not self._over

    def _room(self, rows: int) -> tuple[np.ndarray, np.ndarray]:
        """Return room for ticks and values of recorded rows."""
        words = self._layout.words
        return np.empty(rows, dtype=np.int64), np.empty((rows, words), dtype=np.int64)

    def _go(self, scheme: Scheme, until: int, room: tuple[np.ndarray, ...]) -> tuple[int, int]:
        """Step to a tick, or until the room is full; returns the status and its component.

        Raises:
            FmuError, GraphError: as `run`.
        """
        self._now[ROW] = 0
        slow = scheme.at_once == _SLOW_STEPS_AT_ONCE  # Python called by compiled code loses signals
        with calling(f"what begins at {self.time_s:g} s of simulated time"):
            run = uninterrupted(self._steps) if slow else self._steps
            if self._clocks:
                self._over = True  # if it raises
                run = partial(self._clocks.run, run, self._layout)
            else:
                run = partial(run, self._layout.tables, self._layout.memory)
            found = run(self._coupling, scheme, self._now, until, *room)
        self._over = found[0] != FMI_OK
        self._check(*found)
        return found[:2]

    def hold(self, values: Sequence[float]) -> None:
        """Give new values to the `inputs`, each of which was given at one time, from now on."""
        for (node, (kind, _)), value in zip(self._inputs.items(), values, strict=True):
            if not (math.isfinite(value) and kind.startswith(("Real", "Float"))):
                check_values(node, kind, [self._scheme.start_s], [value])
        self._layout.tables.given[1] = values

    def reader(self, names: Sequence[str]) -> Callable[[], list[float]]:
        """Return a function that reads the present values of recorded scalar variables."""
        return self._layout.reader([find(self._fmus, name) for name in names])

    @property
    def can_go_back(self) -> bool:
        """Return whether all FMUs can save their states."""
        return all(i.fmu.interface.canGetAndSetFMUstate for i in self._instances.values())

    def keep(self) -> None:
        """Save everything, for `go_back`; once.

        Raises:
            FmuError: an FMU cannot save its state.
        """
        self._check(*save(self._layout.tables, self._layout.memory, self._coupling, HOME))
        changing = (*self._coupling, self._now)
        clocks = self._clocks and self._clocks.states
        self._kept = [array.copy() for array in changing], self._over, clocks

    def go_back(self) -> None:
        """Restore what `keep` has saved; the same bits follow.

        Raises:
            FmuError: an FMU refuses its state.
        """
        arrays, self._over, clocks = self._kept
        if self._clocks and clocks:
            self._clocks.states = clocks
        for array, kept in zip((*self._coupling, self._now), arrays, strict=True):
            array[:] = kept
        self._check(*restore(self._layout.tables, self._layout.memory, self._coupling, HOME))

    def _result(self, ticks: np.ndarray, rows: np.ndarray, ended: str | None) -> SystemRun:
        block = rows.view(np.uint8)
        signals = {".".join(n): self._layout.places[n].read(block) for n in self._recorded}
        counts = self._layout.tables.counts
        profile = {
            name: Share(int(steps), int(rollbacks), 1e-9 * int(ns), int(warnings))
            for name, (steps, rollbacks, ns, warnings) in zip(self._instances, counts, strict=True)
        }
        for name, instance in self._instances.items():
            log, number = instance.log, profile[name].warnings
            if (number or log.warning) and log.level != "off":
                said = "; the last one: " + log.warning if log.warning else ""
                _LOG.warning("component %s: %d of its steps gave a warning%s", name, number, said)
                log.warning = ""
        counts[:, COUNT.warnings] = 0
        time_s = self._scheme.start_s + ticks * self._scheme.tick_s
        return SystemRun(time_s, signals, ended, profile)

    def _feed(self, until: int) -> int:
        """Sample inputs that are functions; returns the tick up to which a run may go with them."""
        if any(callable(given) for _, given in self._inputs.values()):
            begin = int(self._now[TICK])
            until = min(until, begin + _STEPS_AT_ONCE)
            ticks = np.arange(begin, until + 1)
            found = sampled(self._inputs, self._scheme.start_s + ticks * self._scheme.tick_s)
            self._layout.feed(found)
        return until

    def _check(self, status: int, component: int, phase: int) -> None:
        """Raise the error of a failed call."""
        if status in (FMI_OK, STATUS.ended):
            return
        if status in (STATUS.no_solution, STATUS.unsettled):
            raise self._not_solved(status)
        instance = list(self._instances.values())[component]
        said = f"{_WHAT[phase]} (fmi{instance.fmu.standard}Status {status})"
        if status == STATUS.stuck:
            said = "returned early without end"
        elif status == STATUS.not_a_number:
            block = self._layout.memory.u1[None, : 8 * self._layout.words]
            wrong = [
                name for (c, name), place in self._layout.places.items()
                if c == instance.name and "f" in place.dtype and place.offset < block.shape[1]
                and np.isnan(place.read(block)).any()
            ]  # fmt: skip
            said = f"puts out nan ({', '.join(wrong)})"
        raise instance.failure(self.time_s, said, status if status <= FMI_FATAL else FMI_ERROR)

    def _not_solved(self, status: int) -> GraphError:
        """Return the error of inputs and outputs that do not come to agree."""
        s, layout = self._coupling, self._layout
        worst, residual, value = s.worst()
        byte = 8 * int(s.torn[worst] if status == STATUS.no_solution else layout.words + worst)
        node = layout.node_at(byte)
        sources = {link.target: ".".join(link.source) for link in layout.links}
        said = f"at {self.time_s:.5f} s the loop through {sources.get(node)} -> {'.'.join(node)}"
        if status == STATUS.unsettled:
            return GraphError(
                f"{said} does not settle after {self._scheme.exchanges} exchanges; pass --loops "
                "explicit to accept a delay of one step in it"
            )
        return GraphError(
            f"{said} was not solved: the residual is {residual:.3g} where its value "
            f"is {value:.6g}; pass --loops explicit to accept a delay of one step "
            "in loops, another start value, or a shorter step"
        )

    @calling("its end")
    def close(self) -> None:
        """Free all instances; further calls are errors."""
        if hasattr(self, "_finalizer"):
            self._finalizer()
        else:
            _free(self._instances, None)

    def __enter__(self) -> "System":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _free(instances: Mapping[str, Instance], states: np.ndarray | None) -> None:
    for k, instance in enumerate(instances.values()):
        for state in () if states is None else states[:, k]:
            if state:
                instance.free_state(int(state))
        instance.close()


def _steps_of(fmus: Mapping[str, Fmu], step_s: float, own: Mapping[str, float]) -> dict[str, float]:
    """Return communication steps in s by component."""
    for name, value in own.items():
        if name not in fmus:
            raise GraphError(f"a step is given to '{name}'; components are {', '.join(fmus)}")
        require_positive(f"step of {name}", value)
    return {name: own.get(name, step_s) for name in fmus}


def require_positive(name: str, value: float) -> None:
    """Refuse a value that is not positive and finite; raises GraphError."""
    if not 0.0 < taken(name, value, float, GraphError) < math.inf:
        raise GraphError(f"{name} {value:g}: choose one above 0")


def _clock() -> int:
    """Return the address of the function that reads the time."""
    if os.name == "nt":
        raise GraphError("profile needs clock_gettime, which Windows does not have; leave it out")
    return function_address(ctypes.CDLL(None).clock_gettime)
