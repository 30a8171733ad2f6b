"""Communication step control: a driver that rolls FMUs back and halves the step where needed.

The bodies see motor angles interpolated between the ends of a communication step. Here a step is
tried, with a look at its middle; if the angle there is further from the interpolated one than the
tolerance, the FMUs return to the start of the step (their saved state) and try half of it. An
accepted step is tried twice as long the next time. Slow (fmpy's Python classes), but with a tenth
of the exchanges; the compiled driver at a fixed step needs no step control.
"""

from cosim.coupling.assembly import MOTOR_NAMES, Motors
from cosim.coupling.master import ReferenceDriver
from cosim.coupling.plant import Plant, exchanged
from cosim.coupling.signals import RawSamples, State
from cosim.physics.lanes import width_of

_ONE = width_of(1)


class AdaptiveDriver(ReferenceDriver):
    """Steps the FMUs through fmpy with communication steps of 1 tick up to a control period.

    The FMUs must be able to vary their step and to save their state
    (`cosim.coupling.interface.check_use`).

    Attributes:
        steps, rejected: communication steps accepted, and tried in vain.
    """

    def __init__(self, motors: Motors) -> None:
        super().__init__(motors)
        self.steps = self.rejected = 0
        self._count = 1

    def _step(self, plant: Plant, state: State, raw: RawSamples, tick: int, end: int) -> int:
        count = min(self._count, end - tick)
        while not self._accepted(plant._replace(ticks_per_step=count), state):
            self.rejected += 1
            count //= 2
        self.steps += 1
        self._count = min(2 * count, plant.ticks_per_period)
        return super()._step(plant._replace(ticks_per_step=count), state, raw, tick, end)

    def _accepted(self, plant: Plant, state: State) -> bool:
        """Try a communication step and roll it back; whether its middle is well interpolated."""
        count, dt = plant.ticks_per_step, plant.body.dt
        if count == 1:
            return True
        half = count // 2
        trial = state._replace(held=state.outputs, outputs=state.outputs.copy())
        middle = state.outputs.copy()
        with self.motors.rolled_back():
            self.motors.step(half, dt)
            self.motors.get_outputs(middle, dt)
            self.motors.step(count - half, dt)
            self.motors.get_outputs(trial.outputs, dt)
        errors = [
            abs(exchanged(plant, trial, motor, column, half - 1, _ONE)[0] - middle[motor, column])
            for motor in range(len(MOTOR_NAMES))
            for column in range(middle.shape[1])
        ]
        return bool(max(errors) <= plant.exchange_tolerance)
