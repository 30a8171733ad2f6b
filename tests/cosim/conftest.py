"""Shared by the co-simulation's tests: edited FMUs, and a policy that needs no training."""

import math
import zipfile
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from cosim.navigation.features import DIRECTION_COUNT, Observation


class StraightPolicy:
    """Heads for the target by the shortest path, blind for the other robot."""

    def __init__(self, targets: tuple[tuple[int, int], ...]) -> None:
        self._targets = np.array(targets)

    def act(self, observation: Observation) -> np.ndarray:
        offset = np.sign(self._targets - observation.cells)
        sector = 2.0 * math.pi / DIRECTION_COUNT
        turns = np.round(np.arctan2(offset[:, 1], offset[:, 0]) / sector)
        return turns.astype(int) % DIRECTION_COUNT


@pytest.fixture
def edited_fmu(motor_fmu, tmp_path) -> Callable[..., Path]:
    """A copy of a motor FMU whose modelDescription (its root element) was edited in place."""

    def make(edit: Callable[[ElementTree.Element], object], original: Path = motor_fmu) -> Path:
        path = tmp_path / "edited.fmu"
        with zipfile.ZipFile(original) as archive, zipfile.ZipFile(path, "w") as copy:
            for name in archive.namelist():
                content = archive.read(name)
                if name == "modelDescription.xml":
                    root = ElementTree.fromstring(content)
                    edit(root)
                    content = ElementTree.tostring(root)
                copy.writestr(name, content)
        return path

    return make


@pytest.fixture(scope="session")
def straight_policy() -> type[StraightPolicy]:
    return StraightPolicy
