"""Communication step control: a driver that rolls FMUs back and halves the step where needed.

The bodies see motor angles interpolated between the ends of a communication step. Here a step is
tried, with a look at its middle; if the angle there is further from the interpolated one than the
tolerance, the FMUs return to the start of the step (their saved state) and try half of it. An
accepted step is tried twice as long the next time. Slow (fmpy's Python classes), but with a tenth
of the exchanges; the compiled driver at a fixed step needs no step control.
"""

import numpy as np

from cosim.coupling.fmu import Motor
from cosim.coupling.master import ReferenceDriver
from cosim.coupling.plant import Plant, exchanged
from cosim.coupling.signals import RawSamples, State


class AdaptiveDriver(ReferenceDriver):
    """Steps the FMUs through fmpy with communication steps of 1 tick up to a control period.

    The FMUs must be able to vary their step and to save their state
    (`cosim.coupling.interface.check_use`).

    Attributes:
        steps, rejected: communication steps accepted, and tried in vain.
    """

    def __init__(self, motors: list[Motor]) -> None:
        super().__init__(motors)
        self.steps = self.rejected = 0
        self._count = 1

    def _step(
        self, plant: Plant, state: State, raw: RawSamples, first_tick: int, tick: int, end: int
    ) -> int:
        count = min(self._count, end - tick)
        while not self._accepted(plant._replace(ticks_per_step=count), state, first_tick + tick):
            self.rejected += 1
            count //= 2
        self.steps += 1
        self._count = min(2 * count, plant.ticks_per_period)
        return super()._step(
            plant._replace(ticks_per_step=count), state, raw, first_tick, tick, end
        )

    def _accepted(self, plant: Plant, state: State, tick: int) -> bool:
        """Try a communication step and roll it back; whether its middle is well interpolated."""
        count, dt = plant.ticks_per_step, plant.body.dt
        if count == 1:
            return True
        half = count // 2
        trial = state._replace(held=state.outputs, outputs=np.empty_like(state.outputs))
        middle = np.empty(state.outputs.shape[:2])
        for motor, slot in self._slots(state):
            with motor.rolled_back():
                motor.step(tick, half, dt)
                middle[slot] = motor.outputs(tick + half, dt)[0]
                motor.step(tick + half, count - half, dt)
                trial.outputs[slot] = motor.outputs(tick + count, dt)
        error = max(
            abs(exchanged(plant, trial, slot[0], slot[1], half - 1)[0] - middle[slot])
            for _, slot in self._slots(state)
        )
        return bool(error <= plant.exchange_tolerance)
