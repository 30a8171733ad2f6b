"""Build hook of the wheel: it carries what its users would need a C compiler for.

That is the FMUs for all platforms, and kernels of pages for the paper's robot. hatchling calls it,
with the project's dependencies at hand. MINIROBOTS_WHEEL_TARGETS and MINIROBOTS_WHEEL_PAGES name
fewer of both, separated by spaces, for a wheel that is built sooner.
"""

import os
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin import interface  # pyright: ignore[reportMissingImports]

# A page's scenario and method for each module of the paper's robot: tables of one robot and of two,
# times of a pair, plans.
PAGES = ("1a/shortest", "4/shortest", "4/fastest", "4-cross/planned")


class Built(interface.BuildHookInterface):
    """Hook that builds FMUs and kernels and puts them into the wheel."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Build what the wheel is to hold; an editable installation builds it when needed."""
        if version == "editable":
            return
        sys.path.insert(0, self.root)
        from agent.web.compiler import CACHED
        from agent.web.page import module_of
        from cosim.base.storage import PACKAGED, write_checksum
        from fmus.build import CARRIED, build_fmus
        from fmus.compiler import TARGETS
        from fmus.models import MODELS

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
        pages = os.environ.get("MINIROBOTS_WHEEL_PAGES", " ".join(PAGES)).split()
        self.app.display("MINIROBOTS_WHEEL_TARGETS=x86_64-linux, for example, builds sooner")
        for model in MODELS:
            self.app.display(f"compiling {model} for {', '.join(targets)}")
            (path,) = build_fmus({"3": work / f"{model}.fmu"}, targets, model=model)
            build_data["force_include"][str(path)] = str(CARRIED / path.name)
        for page in pages:
            self.app.display(f"compiling the kernels of pages like {page}")
            module = module_of(*page.split("/"))
            path = work / module.name
            path.write_bytes(module.content)
            write_checksum(path)
            for file in (path, path.with_name(f"{path.name}.sha256")):
                inside = PACKAGED.relative_to(self.root) / CACHED / file.name
                build_data["force_include"][str(file)] = str(inside)

    def finalize(self, version: str, _build_data: dict[str, Any], _artifact: str) -> None:
        """Remove what is in the wheel now."""
        if version != "editable":
            self._folder.cleanup()
