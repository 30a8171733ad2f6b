"""A page's episode in this process, from the same C: what tests compare with the kernels."""

import ctypes
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from agent.web.layout import TABLES, VIEW
from agent.web.packing import Packed
from cosim.coupling.rl_step import Step, SupportsAct, decide
from cosim.model.outcome import BY_RANK, Outcome
from cosim.simulation.cosimulation import CoSimulation
from cosim.simulation.options import Setup
from cosim.simulation.simulate import draw_episode


def steps_of(policy: SupportsAct, setup: Setup, seed: int) -> Iterator[tuple[CoSimulation, Step]]:
    """Yield the RL steps of the first episode of `cosim.simulate` with a seed, as they end."""
    simulation = CoSimulation(setup.scenario, setup.fmu, setup.config)
    observation = simulation.reset(*draw_episode(setup.scenario, seed, 0))
    while not simulation.outcome:
        step = simulation.advance(decide(policy, observation).action)
        observation = step.after
        yield simulation, step
    simulation.close()


class NativeEpisode:
    """An episode of a compiled library."""

    def __init__(self, library: Path, packed: Packed) -> None:
        self._c = ctypes.CDLL(str(library))
        for name in ("setup", "view", "table"):
            getattr(self._c, f"episode_{name}").restype = ctypes.c_void_p
        self._c.episode_table.argtypes = (ctypes.c_int, ctypes.c_size_t)
        self._c.episode_begin.argtypes = (ctypes.c_double, ctypes.c_uint32)
        setup = packed.setup
        ctypes.memmove(self._c.episode_setup(), setup.ctypes.data, setup.nbytes)
        for place, name in enumerate(TABLES):
            table = packed.tables.get(name, np.empty(0))
            room = self._c.episode_table(place, table.nbytes)
            if table.nbytes:
                ctypes.memmove(room, table.ctypes.data, table.nbytes)

    def begin(self, seed: int, number: int = 0) -> Outcome:
        """Begin an episode of a seeded series."""
        outcome = self._c.episode_begin(float(seed), number)
        assert outcome >= 0, "no starts"
        return BY_RANK[outcome]

    def aim(self, robot: int, column: int, row: int) -> bool:
        """Give a robot another target; whether there is room."""
        return bool(self._c.episode_aim(robot, column, row) & 1)

    def advance(self, periods: int) -> Outcome:
        """Simulate control periods, and return how the episode ended, if it did."""
        return BY_RANK[self._c.episode_advance(periods)]

    def view(self) -> dict[str, np.ndarray]:
        """Return what the episode shows of itself, see `agent.web.layout.VIEW`."""
        size = sum(field.size for field in VIEW.values())
        numbers = np.ctypeslib.as_array(
            ctypes.cast(self._c.episode_view(), ctypes.POINTER(ctypes.c_double)), (size,)
        ).copy()
        return {name: numbers[f.start : f.start + f.size] for name, f in VIEW.items()}
