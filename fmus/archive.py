"""Archives of FMUs: zip files whose bytes depend on their contents alone."""

import zipfile
from collections.abc import Mapping
from pathlib import Path

from cosim.base.storage import replacing
from fmus.compiler import TARGETS
from fmus.models import Fmi

# The first time a zip archive can tell: an archive says nothing of when it was made.
ZIP_EPOCH = (1980, 1, 1, 0, 0, 0)


def binaries(fmi: Fmi, name: str, libraries: Mapping[str, bytes]) -> dict[str, bytes]:
    """Libraries by their place in the archive of that standard."""
    if fmi == "3":
        places = {target: target for target in libraries}
    else:
        # FMI 2.0 has no names for aarch64: importers there look into linux64, win64 and darwin64
        # too, which an archive for both architectures must leave to x86-64.
        places = {"x86_64-linux": "linux64", "x86_64-windows": "win64", "x86_64-darwin": "darwin64"}
        places |= {
            target: target if other in libraries else places[other]
            for target, other in ((t, t.replace("aarch64", "x86_64")) for t in libraries)
            if target != other
        }
    return {
        f"binaries/{places[target]}/{name}{TARGETS[target].suffix}": content
        for target, content in libraries.items()
    }


def write_archive(path: Path, files: Mapping[str, bytes]) -> None:
    """Write files by their names as a zip archive; equal files give equal archives."""
    with replacing(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        for name, content in files.items():
            entry = zipfile.ZipInfo(name, ZIP_EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.create_system = 3  # Unix, wherever it was built: equal builds are equal bytes
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, content)
