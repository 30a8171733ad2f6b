"""The driver that steps the motors with fmpy: one call of `doStep` per control period.

One FMU instance has all motors of a batch. In a `doStep` it makes the ticks of a control period on
its own and keeps its outputs at the end of each communication step (`samples`), which the bodies
then see one after the other. The compiled loop calls Python for the `doStep` of fmpy's class; it
exchanges inputs and outputs itself, through the functions of the library that fmpy has loaded.
"""

import ctypes
from collections.abc import Callable

import numpy as np
from fmpy.fmi1 import FMICallException

from cosim.base.jit import uninterrupted
from cosim.coupling.calls import INCOMPLETE, RAISED
from cosim.coupling.interface import OUTPUTS
from cosim.coupling.master import CompiledDriver
from cosim.coupling.plant import Plant
from cosim.coupling.signals import MOTORS, RawSamples, Samples, State, aligned
from cosim.fmi.abi import FMI_OK

_CALLBACK = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p)


class FmpyDriver(CompiledDriver):
    """Steps all motors by `doStep` of fmpy's FMU3Slave, once per control period; bodies in lanes.

    The motors must be made with `sampled`.
    """

    @uninterrupted  # what a signal raises would be lost on its way out of compiled code
    def advance(
        self, plant: Plant, state: State, noise: np.ndarray, samples: Samples, raw: RawSamples
    ) -> None:
        """See `Driver.advance`."""
        steps = plant.ticks_per_period // plant.ticks_per_step
        failures: list[BaseException] = []
        callback = _CALLBACK(self._stepper(plant, failures))
        self.calls = self.motors.calls._replace(
            step_period=ctypes.cast(callback, ctypes.c_void_p).value,
            sampled=aligned(len(OUTPUTS) * steps * MOTORS, state.inputs.shape[1]),
        )
        try:
            super().advance(plant, state, noise, samples, raw)
        except Exception as error:
            if failures and not isinstance(failures[0], FMICallException):
                raise failures[0] from None
            raise error from (failures or [None])[0]

    def _stepper(self, plant: Plant, failures: list[BaseException]) -> Callable[[object], int]:
        """Return a function that steps all motors over a control period and returns a status.

        Args:
            plant: constants.
            failures: gets what is raised.
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
