"""Shared by the tests of the co-simulation: edited FMUs."""

import zipfile
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import pytest


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
