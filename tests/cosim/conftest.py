"""Shared by the co-simulation's tests: the motor FMU, and a policy that needs no training."""

import math
from pathlib import Path

import numpy as np
import pytest

from cosim.features import DIRECTION_COUNT, Observation
from fmus.build import cached_fmu


class StraightPolicy:
    """Heads for the target by the shortest way, blind for the other robot."""

    def __init__(self, targets: tuple[tuple[int, int], ...]) -> None:
        self._targets = np.array(targets)

    def act(self, observation: Observation) -> np.ndarray:
        way = np.sign(self._targets - observation.cells)
        sector = 2.0 * math.pi / DIRECTION_COUNT
        return np.round(np.arctan2(way[:, 1], way[:, 0]) / sector).astype(int) % DIRECTION_COUNT


@pytest.fixture(scope="session")
def motor_fmu() -> Path:
    return cached_fmu()


@pytest.fixture(scope="session")
def straight_policy() -> type[StraightPolicy]:
    return StraightPolicy
