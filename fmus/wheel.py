"""Build hook of the wheel: it carries the FMUs for all platforms, so that its users compile none.

hatchling calls it, with `dependencies` of pyproject.toml at hand. MINIROBOTS_WHEEL_TARGETS names
fewer platforms (separated by spaces) for whoever needs a wheel sooner.
"""

import os
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin import interface  # pyright: ignore[reportMissingImports]


class BuiltFmus(interface.BuildHookInterface):
    """Hook that builds the FMUs and puts them into the wheel."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Build what the wheel is to hold; an editable installation builds FMUs when needed."""
        if version == "editable":
            return
        sys.path.insert(0, self.root)
        from fmus.build import CARRIED, build_fmus  # noqa: PLC0415 - of the source that is built
        from fmus.compiler import TARGETS  # noqa: PLC0415
        from fmus.models import MODELS  # noqa: PLC0415

        core = self.metadata.core
        self._folder = tempfile.TemporaryDirectory()
        work = Path(self._folder.name)
        # The FMUs say whose they are by the metadata of an installation, which is not there yet.
        about = work / f"{core.name}-{core.version}.dist-info"
        (about / "licenses").mkdir(parents=True)
        shutil.copy(Path(self.root) / "LICENSE", about / "licenses")
        (about / "METADATA").write_text(
            f"Metadata-Version: 2.4\nName: {core.name}\nVersion: {core.version}\n"
            f"License-Expression: {core.license_expression}\n"
        )
        sys.path.append(str(work))
        targets = os.environ.get("MINIROBOTS_WHEEL_TARGETS", "").split() or list(TARGETS)
        self.app.display("MINIROBOTS_WHEEL_TARGETS=x86_64-linux, for example, builds sooner")
        for model in MODELS:
            self.app.display(f"compiling {model} for {', '.join(targets)}")
            (path,) = build_fmus({"3": work / f"{model}.fmu"}, targets, model=model)
            build_data["force_include"][str(path)] = str(CARRIED / path.name)

    def finalize(self, version: str, _build_data: dict[str, Any], _artifact: str) -> None:
        """Remove what is in the wheel now."""
        if version != "editable":
            self._folder.cleanup()
