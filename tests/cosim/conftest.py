"""Shared by the tests of the co-simulation: edited FMUs."""

from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import pytest

from tests.alone import edited


@pytest.fixture
def edited_fmu(motor_fmu, tmp_path) -> Callable[..., Path]:
    """A copy of a motor FMU whose modelDescription (its root element) was edited in place."""

    def make(edit: Callable[[ElementTree.Element], object], original: Path = motor_fmu) -> Path:
        def change(name: str, content: bytes) -> bytes:
            if name != "modelDescription.xml":
                return content
            root = ElementTree.fromstring(content)
            edit(root)
            return ElementTree.tostring(root)

        return edited(original, tmp_path / "edited.fmu", change)

    return make
