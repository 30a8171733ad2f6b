"""The co-simulation master: couples motor FMUs to the rigid bodies, tick by tick.

A communication step is one or more ticks of dt. Every motor steps over it with the inputs of its
start, then every body does, tick by tick, with the motors' outputs of its end, interpolated from
its start. Inputs change once per control period, with the reaction of the body after
every step. Time is an integer tick count.

Three drivers give the same bits. `CompiledDriver` calls the FMU's C functions from machine code and
moves bodies in the lanes of vectors. `FmpyDriver` does the same, but fmpy
steps the FMU, once per control period. `ReferenceDriver` goes through fmpy's Python classes at
every communication step, one body after the other.
"""

import ctypes
from abc import ABC, abstractmethod
from collections.abc import Callable

import numpy as np
from fmpy.fmi1 import FMICallException

from cosim.base.errors import UserError
from cosim.base.jit import interrupts_held, kernel
from cosim.coupling.period import (
    DIVERGED,
    TIPPED,
    begin_period,
    end_period,
    restore_ended,
    sample_tick,
)
from cosim.coupling.plant import Plant, begin_step, push_bodies, react, step_robots
from cosim.coupling.signals import RawSamples, Samples, State, aligned, signal_names, sizes_of
from cosim.fmi.calls import (
    FMI_OK,
    FMI_WARNING,
    INCOMPLETE,
    NOT_FINITE,
    RAISED,
    Calls,
    exchange_signals,
    set_inputs,
    step_motors,
    step_period,
    take_sampled,
)
from cosim.fmi.motors import Motors
from cosim.model.params import motor_names
from cosim.physics.lanes import Width, width_of

_ONE = width_of(1)
_CALLBACK = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p)


class FaultError(UserError):
    """A robot that the model no longer describes.

    Attributes:
        column: of the robot in the state.
        ticks: done by the driver in this call until then.
    """

    def __init__(self, text: str, column: int = 0, ticks: int = 0) -> None:
        """Keep what is wrong; in the text, {robot}, {time_s} and {machine} are for `locate`."""
        super().__init__(text)
        self.column, self.ticks = column, ticks

    def locate(self, robot: str, time_s: float, machine: str) -> "FaultError":
        """Return this error with the robot, the simulated time and the machine in its message."""
        self.args = (str(self).format(robot=robot, time_s=time_s, machine=machine),)
        return self


class NotFiniteError(FaultError):
    """A signal that is no finite number, at the first tick at which it is none."""


class FallError(FaultError):
    """A robot that does not stand on its feet any more at the end of a control period."""


_FALLS = {
    TIPPED: "{robot} tips over at {time_s:.2f} s of simulated time; lower the centre of mass of "
    "machine {machine}, move its feet outwards, or drive it slower",
    DIVERGED: "the contacts of {robot} with the floor are not solved in over 1 % of the time up to "
    "{time_s:.2f} s; move the feet of machine {machine} outwards, lower its centre of mass, or "
    "correct its moments of inertia",
}


def _not_finite(state: State, tick: int) -> NotFiniteError:
    values = np.concatenate([state.motors.inputs, state.motors.outputs, state.bodies.motion])
    size = np.nan_to_num(np.abs(values), nan=np.inf, posinf=np.inf)
    row, column = map(int, np.unravel_index(size.argmax(), size.shape))
    motors, *feet = sizes_of(state)
    signal = signal_names(motor_names(motors), *feet)[row]
    return NotFiniteError(
        f"{signal} of {{robot}} is {values[row, column]} at {{time_s:.5f}} s of simulated time; "
        "choose a smaller --dt, or look at its motor FMU and at its world",
        column,
        tick + 1,
    )


def _refuse_falls(plant: Plant, state: State) -> None:
    """Raise the first fault that ended an episode."""
    for column in np.flatnonzero(np.isin(state.episodes.events, list(_FALLS))).tolist():
        if periods := int(state.episodes.periods[column // plant.robots]):
            ticks = periods * plant.ticks_per_period
            raise FallError(_FALLS[int(state.episodes.events[column])], column, ticks)


class Driver(ABC):
    """Advances the coupled system: the motors of all robots, and bodies in vectors of `lanes`.

    Order of calls: `Motors` (not one instance is there yet), the driver, `Motors.restart` for the
    robots of each episode that begins, which makes the instances, and then `advance` any number of
    times, with restarts between. `advance` does for every control period:

    1. Commands and noise become inputs of the motors, which are set.
    2. For every communication step: motors step, their outputs are read, and bodies move tick by
       tick with them; with reaction, inputs are set again with what the bodies did.
    3. Voltages and currents are read, and the period's samples are kept.
    """

    def __init__(self, motors: Motors, lanes: int = 1) -> None:
        self.motors = motors
        self.lanes = lanes

    @abstractmethod
    def advance(
        self, plant: Plant, state: State, noise: np.ndarray, samples: Samples, raw: RawSamples
    ) -> None:
        """Run whole control periods, until something ends the last running episode.

        Args:
            state: variables of B columns, which `lanes` divides; changed in place.
            noise: (n, B, 2) speed noise of n periods, over each motor's set point.
            samples: room for n periods of B columns.
            raw: room for a burst of the first m ticks.
        """


class ReferenceDriver(Driver):
    """Steps the FMUs through fmpy's Python classes, and one body after the other.

    Calls `Motors.set_inputs` once per control period, `step` and `get_outputs` once per
    communication step, for each instance, and `get_electrical` at the end of the period.
    """

    def advance(
        self, plant: Plant, state: State, noise: np.ndarray, samples: Samples, raw: RawSamples
    ) -> None:
        """See `Driver.advance`."""
        tick, dt, count, motors = 0, plant.body.dt, plant.ticks_per_step, self.motors
        for period in range(len(noise)):
            begin_period(plant, state, noise[period], 1)
            motors.set_inputs(state.motors.inputs, dt)
            for _ in range(plant.ticks_per_period // count):
                begin_step(plant, state)
                motors.step(count, dt)
                motors.get_outputs(state.motors.outputs, dt)
                for k in range(count):
                    for column in np.flatnonzero(state.episodes.busy).tolist():
                        if not step_robots(plant, state, column, k, _ONE):
                            raise _not_finite(state, tick)
                    push_bodies(plant, state)
                    if tick < len(raw.omega):
                        sample_tick(plant, state, raw, tick)
                    tick += 1
                if plant.reaction:
                    react(plant, state)
                    motors.set_inputs(state.motors.inputs, dt)
            motors.get_electrical(state.motors.electrical, dt)
            if not end_period(plant, state, samples, period):
                break
        restore_ended(plant, state)
        _refuse_falls(plant, state)


class CompiledDriver(Driver):
    """Steps the FMUs by calling their C functions from a compiled loop, bodies in lanes.

    Calls fmi3SetFloat64 once per control period, fmi3DoStep and fmi3GetFloat64 once per
    communication step, for each instance, and fmi3GetFloat64 of voltages and currents at the end of
    the period. Motors of a vector step just before its bodies.
    """

    def advance(
        self, plant: Plant, state: State, noise: np.ndarray, samples: Samples, raw: RawSamples
    ) -> None:
        """See `Driver.advance`."""
        self._run(plant, state, noise, samples, raw, self.motors.calls)

    def _run(
        self,
        plant: Plant,
        state: State,
        noise: np.ndarray,
        samples: Samples,
        raw: RawSamples,
        calls: Calls,
    ) -> None:
        width, dt = width_of(self.lanes), plant.body.dt
        status, instance = run_periods(plant, state, noise, samples, raw, calls, width)
        if status == NOT_FINITE:
            raise _not_finite(state, instance)
        if status == INCOMPLETE:
            raise self.motors.error(instance, "asked to stop", dt)
        if status > FMI_WARNING:
            raise self.motors.error(instance, f"failed (fmi3Status {status})", dt, status)
        _refuse_falls(plant, state)


class FmpyDriver(CompiledDriver):
    """Steps all motors by `doStep` of fmpy's FMU3Slave, once per control period; bodies in lanes.

    One FMU instance has all motors of a batch, which must be made with `sampled`. Calls once per
    control period fmi3SetFloat64, `doStep`, in which the FMU makes all ticks of the period on its
    own, and fmi3GetFloat64 of its outputs at the end of each communication step, which the bodies
    then get one after the other. The compiled loop makes all calls but `doStep` itself, through the
    functions of the library that fmpy has loaded.
    """

    @interrupts_held()  # what a signal raises would be lost on its way out of compiled code
    def advance(
        self, plant: Plant, state: State, noise: np.ndarray, samples: Samples, raw: RawSamples
    ) -> None:
        """See `Driver.advance`."""
        steps = plant.ticks_per_period // plant.ticks_per_step
        failures: list[BaseException] = []
        callback = _CALLBACK(self._stepper(plant, failures))
        calls = self.motors.calls._replace(
            step_period=ctypes.cast(callback, ctypes.c_void_p).value,
            sampled=aligned(len(state.motors.outputs) * steps, state.motors.outputs.shape[1]),
        )
        try:
            self._run(plant, state, noise, samples, raw, calls)
        except Exception as error:
            if failures and not isinstance(failures[0], FMICallException):
                raise failures[0] from None
            raise error from (failures or [None])[0]

    def _stepper(self, plant: Plant, failures: list[BaseException]) -> Callable[[object], int]:
        """Return a function that steps all motors over a control period and returns a status.

        `failures` gets what is raised.
        """
        motor = self.motors.array
        if motor is None:
            return lambda _: FMI_OK  # there is no period to simulate either
        do_step, ticks, dt_s = motor.slave.doStep, plant.ticks_per_period, plant.body.dt
        now = ctypes.c_int64.from_buffer(self.motors.calls.ticks.data)

        def step(_: object) -> int:
            try:
                tick = now.value
                _, terminate, early_return, _ = do_step(tick * dt_s, ticks * dt_s)
            except BaseException as error:
                failures.append(error)
                return error.status if isinstance(error, FMICallException) else RAISED
            if terminate or early_return:
                return INCOMPLETE
            now.value = tick + ticks
            return FMI_OK

        return step


@kernel
def run_periods(
    plant: Plant,
    state: State,
    noise: np.ndarray,
    samples: Samples,
    raw: RawSamples,
    calls: Calls,
    width: Width,
) -> tuple[int, int]:
    """The loop of `CompiledDriver`: `Driver.advance`.

    Returns the fmi3Status of a failed call and its instance's index; or NOT_FINITE and the tick.
    """
    dt, count = plant.body.dt, plant.ticks_per_step
    instances, lanes = calls.instances.shape[0], len(width)
    sampled = calls.step_period != 0
    get, electrical = calls.functions.get_float64, calls.electrical
    # here, because numba counts a record's references where it is taken from another one
    inputs, outputs, busy = state.motors.inputs, state.motors.outputs, state.episodes.busy
    tick = 0
    for period in range(noise.shape[0]):
        begin_period(plant, state, noise[period], lanes)
        fresh_inputs = not sampled
        if sampled:
            status = step_period(calls, inputs)
            if status > FMI_WARNING:
                return status, 0
        for step in range(plant.ticks_per_period // count):
            begin_step(plant, state)
            if sampled:
                take_sampled(calls, outputs, step, width)
            if fresh_inputs:
                status, instance = set_inputs(calls, inputs)
                if status > FMI_WARNING:
                    return status, instance
            if instances == 1 and not sampled:
                status, instance = step_motors(calls, outputs, 0, 1, count, dt)
                if status > FMI_WARNING:
                    return status, instance
            for k in range(count):
                for column in range(0, outputs.shape[1], lanes):
                    if not busy[column]:
                        continue
                    if instances > 1 and k == 0:
                        # Motors just before their bodies: the processor then works on several
                        # vectors at once. No motor sees a body before the next step, so order is
                        # free.
                        first, end = calls.motors * column, calls.motors * (column + lanes)
                        status, instance = step_motors(calls, outputs, first, end, count, dt)
                        if status > FMI_WARNING:
                            return status, instance
                    if not step_robots(plant, state, column, k, width):
                        return NOT_FINITE, tick
                push_bodies(plant, state)
                if tick < raw.omega.shape[0]:
                    sample_tick(plant, state, raw, tick)
                tick += 1
            fresh_inputs = plant.reaction
            if plant.reaction:
                react(plant, state)
        electric = state.motors.electrical
        status, instance = exchange_signals(calls, get, electrical, electric, 0, instances)
        if status > FMI_WARNING:
            return status, instance
        if not end_period(plant, state, samples, period):
            break
    restore_ended(plant, state)
    return FMI_OK, 0
