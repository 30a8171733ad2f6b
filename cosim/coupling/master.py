"""The co-simulation master: couples motor FMUs to the rigid bodies, tick by tick.

A communication step is one or more ticks of dt. Every motor steps over it with the inputs of its
start, then every body does, tick by tick, with the motors' outputs of its end (Gauss–Seidel) or
of its start (Jacobi). Inputs change once per control period, with the reaction of the body after
every step. Time is an integer tick count.

Two drivers: `CompiledDriver` calls the FMU's C functions from machine code, `ReferenceDriver` goes
through fmpy's Python classes; both give the same bits.
"""

from typing import Any, NamedTuple, Protocol

import numpy as np

from cosim.base.jit import kernel
from cosim.base.outcome import RUNNING
from cosim.coupling.calls import INCOMPLETE, do_step, exchange_float64
from cosim.coupling.fmu import FMI_OK, FMI_WARNING, Motor
from cosim.coupling.plant import (
    Plant,
    begin_period,
    begin_step,
    end_period,
    push_pairs,
    react,
    sample_tick,
    step_robot,
)
from cosim.coupling.signals import MOTORS, RawSamples, Samples, State


class Advance(NamedTuple):
    """How far an advance came.

    Attributes:
        periods: control periods completed.
        event: RUNNING, COLLISION or OUT_OF_BOARD of `cosim.base.outcome`.
    """

    periods: int
    event: int


class Driver(Protocol):
    """Advances the coupled system; owns the motors' clock."""

    motors: list[Motor]

    def advance(
        self,
        plant: Plant,
        state: State,
        noise: np.ndarray,
        samples: Samples,
        raw: RawSamples,
        first_tick: int,
    ) -> Advance:
        """Run whole control periods until an event.

        Args:
            plant: constants.
            state: variables of N robots, changed in place.
            noise: (n, N, 2) speed noise of n periods, rad/s.
            samples: room for n periods.
            raw: room for a burst of the first m ticks.
            first_tick: ticks since t = 0.

        Raises:
            FmuError: an FMU refused a call; names the instance, the time and its log message.
        """
        ...


class ReferenceDriver:
    """Steps the FMUs through fmpy's Python classes."""

    def __init__(self, motors: list[Motor]) -> None:
        self.motors = motors

    def advance(
        self,
        plant: Plant,
        state: State,
        noise: np.ndarray,
        samples: Samples,
        raw: RawSamples,
        first_tick: int,
    ) -> Advance:
        """See `Driver.advance`."""
        dt, tick, slots = plant.body.dt, 0, self._slots(state)
        for period in range(len(noise)):
            begin_period(plant, state, noise[period])
            for motor, slot in slots:
                motor.set_inputs(state.inputs[slot], first_tick + tick, dt)
            end = tick + plant.ticks_per_period
            while tick < end:
                tick += self._step(plant, state, raw, first_tick, tick, end)
            for motor, slot in slots:
                state.electrical[slot] = motor.electrical(first_tick + tick, dt)
            event = end_period(plant, state, samples, period)
            if event != RUNNING:
                return Advance(period + 1, event)
        return Advance(len(noise), RUNNING)

    def _slots(self, state: State) -> list[tuple[Motor, Any]]:
        """Each motor with its place (robot, motor) in the arrays of the state."""
        shape = state.inputs.shape[:2]
        return [(motor, np.unravel_index(i, shape)) for i, motor in enumerate(self.motors)]

    def _step(
        self, plant: Plant, state: State, raw: RawSamples, first_tick: int, tick: int, end: int
    ) -> int:
        """One communication step from `tick`; returns the ticks it took."""
        dt, count = plant.body.dt, plant.ticks_per_step
        begin_step(plant, state)
        for motor, slot in self._slots(state):
            motor.step(first_tick + tick, count, dt)
            state.outputs[slot] = motor.outputs(first_tick + tick, dt)
        for k in range(count):
            for robot in range(len(state.bodies)):
                step_robot(plant, state, robot, k)
            push_pairs(plant, state)
            if tick + k < len(raw.omega):
                sample_tick(plant, state, raw, tick + k)
        if plant.reaction:
            react(plant, state)
            for motor, slot in self._slots(state):
                motor.set_inputs(state.inputs[slot], first_tick + tick, dt)
        return count


class Calls(NamedTuple):
    """What compiled code needs to reach the FMUs; integers are addresses.

    Attributes:
        instances: (M,) int64, one per motor, robots outermost.
        set_float64, do_step, get_float64: functions of the binary.
        inputs, outputs, electrical: arrays of value references (uint32).
    """

    instances: np.ndarray
    set_float64: int
    do_step: int
    get_float64: int
    inputs: np.ndarray
    outputs: np.ndarray
    electrical: np.ndarray


class CompiledDriver:
    """Steps the FMUs by calling their C functions from a compiled loop."""

    def __init__(self, motors: list[Motor]) -> None:
        self.motors = motors
        fmu, functions = motors[0].fmu, motors[0].addresses
        instances = np.array([motor.instance for motor in motors], dtype=np.int64)
        self._calls = Calls(instances, *functions, fmu.inputs, fmu.outputs, fmu.electrical)

    def advance(
        self,
        plant: Plant,
        state: State,
        noise: np.ndarray,
        samples: Samples,
        raw: RawSamples,
        first_tick: int,
    ) -> Advance:
        """See `Driver.advance`."""
        periods, event, motor, status = run_periods(
            plant, state, noise, samples, raw, self._calls, first_tick
        )
        if status > FMI_WARNING:
            what = "asked to stop" if status == INCOMPLETE else f"failed (fmi3Status {status})"
            tick = first_tick + periods
            raise self.motors[motor].error(tick * plant.body.dt, what)
        return Advance(periods, event)


@kernel
def run_periods(
    plant: Plant,
    state: State,
    noise: np.ndarray,
    samples: Samples,
    raw: RawSamples,
    calls: Calls,
    first_tick: int,
) -> tuple[int, int, int, int]:
    """The loop of `CompiledDriver`; arguments as for `Driver.advance`.

    Returns:
        Periods completed, event, and of a failed call the motor's index and the fmi3Status; after
        a failure the first number is the tick of the failure, counted from `first_tick`.
    """
    robots, motors = state.bodies.shape[0], calls.instances.shape[0]
    set_inputs, get_values, step = calls.set_float64, calls.get_float64, calls.do_step
    input_references, input_count = calls.inputs.ctypes.data, calls.inputs.shape[0]
    output_references, output_count = calls.outputs.ctypes.data, calls.outputs.shape[0]
    electrical_references, electrical_count = calls.electrical.ctypes.data, 2
    inputs, outputs = state.inputs.ctypes.data, state.outputs.ctypes.data
    electrical = state.electrical.ctypes.data
    dt, count = plant.body.dt, plant.ticks_per_step
    tick = 0
    for period in range(noise.shape[0]):
        begin_period(plant, state, noise[period])
        fresh_inputs = True
        for _ in range(plant.ticks_per_period // count):
            begin_step(plant, state)
            for k in range(count):
                for robot in range(robots):
                    # A robot's motors just before its body: the processor then works on several
                    # robots at once. No motor sees a body before the next step, so order is free.
                    for motor in range(MOTORS * robot, MOTORS * (robot + 1)):
                        if k > 0:
                            break
                        instance = calls.instances[motor]
                        if fresh_inputs:
                            status = exchange_float64(
                                set_inputs,
                                instance,
                                input_references,
                                input_count,
                                inputs + motor * input_count * 8,
                            )
                            if status > FMI_WARNING:
                                return tick, RUNNING, motor, status
                        status = do_step(step, instance, (first_tick + tick) * dt, count * dt)
                        if status > FMI_WARNING:
                            return tick, RUNNING, motor, status
                        status = exchange_float64(
                            get_values,
                            instance,
                            output_references,
                            output_count,
                            outputs + motor * output_count * 8,
                        )
                        if status > FMI_WARNING:
                            return tick, RUNNING, motor, status
                    step_robot(plant, state, robot, k)
                push_pairs(plant, state)
                if tick < raw.omega.shape[0]:
                    sample_tick(plant, state, raw, tick)
                tick += 1
            fresh_inputs = plant.reaction
            if plant.reaction:
                react(plant, state)
        for motor in range(motors):
            status = exchange_float64(
                get_values,
                calls.instances[motor],
                electrical_references,
                electrical_count,
                electrical + motor * electrical_count * 8,
            )
            if status > FMI_WARNING:
                return tick, RUNNING, motor, status
        event = end_period(plant, state, samples, period)
        if event != RUNNING:
            return period + 1, event, 0, FMI_OK
    return noise.shape[0], RUNNING, 0, FMI_OK
