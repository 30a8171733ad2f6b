"""Author, version and licence of the FMUs, of the installed project: for the archive."""

import importlib.metadata
import re
from typing import NamedTuple


class Origin(NamedTuple):
    """Origin of the FMU; fields are named as the model descriptions' attributes.

    Attributes:
        version: of this project.
        author: holder of the copyright.
        copyright: the licence's line of it.
        license: SPDX name of the licence.
    """

    version: str
    author: str
    copyright: str
    license: str


def license_text() -> str:
    """The licence in full."""
    return str(importlib.metadata.distribution("minirobots").read_text("licenses/LICENSE"))


def read_origin() -> Origin:
    """Origin of the FMU, from the project's metadata and licence."""
    project = importlib.metadata.distribution("minirobots")
    (line,) = re.findall(r"^Copyright .*$", license_text(), re.MULTILINE)
    author = re.sub(r"^Copyright \(c\) \d+ ", "", line)
    return Origin(project.version, author, line, project.metadata["License-Expression"])
