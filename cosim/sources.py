"""Which code a result depends on: source files that a module imports, their hash, and versions.

For caches and stored results that must not outlive the code that made them. Hashes are of this
project's files only; versions of libraries are named, not hashed.
"""

import ast
import hashlib
import importlib.metadata
import platform
import re
from collections.abc import Iterable
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]

_PACKAGES = ("minirobots", "fmpy", "numba", "numpy", "rerun-sdk")
_IMPORT = re.compile(r"^ *(?:from|import) +([\w.]+)", re.MULTILINE)


@cache
def imported_files(path: Path) -> frozenset[Path]:
    """Files of this project that a module imports directly."""
    # lines instead of a syntax tree, which would take longer than all other imports of a start
    names = _IMPORT.findall(path.read_text("utf-8"))
    files = (ROOT / f"{name.replace('.', '/')}.py" for name in names)
    return frozenset(file for file in files if file.is_file())


def with_imports(files: Iterable[Path]) -> list[Path]:
    """The files and all that they import, directly or not, sorted."""
    waiting = list(files)
    found: set[Path] = set()
    while waiting:
        file = waiting.pop()
        if file not in found:
            found.add(file)
            waiting += imported_files(file)
    return sorted(found)


def source_digest(files: Iterable[Path], *further: str) -> str:
    """Hash (16 hex digits) of the contents of files, and of texts that matter as well."""
    digest = hashlib.sha256("\0".join(further).encode())
    for path in files:
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def code_digest(files: Iterable[Path]) -> str:
    """Hash (16 hex digits) of what the files do: comments, docstrings and layout do not matter."""
    digest = hashlib.sha256()
    for path in files:
        tree = ast.parse(path.read_bytes())
        for node in ast.walk(tree):
            if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef)):
                documented = ast.get_docstring(node) is not None
                del node.body[: int(documented)]
        digest.update(ast.dump(tree).encode())
    return digest.hexdigest()[:16]


def versions() -> dict[str, str]:
    """Versions of this package, of Python and of the libraries that results depend on."""
    packages = {name: importlib.metadata.version(name) for name in _PACKAGES}
    return packages | {"python": platform.python_version()}
