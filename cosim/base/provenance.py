"""Which code a result depends on: source files that a module imports, their hash, and versions.

For caches and stored results that must not outlive the code that made them. Hashes are of this
project's files only; versions of libraries are named, not hashed.
"""

import ast
import hashlib
import importlib.metadata
import json
import platform
import re
from collections.abc import Collection, Iterable
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

ROOT = Path(__file__).parents[2]
OWN = ("fmus", "cosim", "agent", "analysis")  # packages of this project below ROOT

_PACKAGES = ("minirobots", "fmpy", "numba", "numpy", "rerun-sdk")
# Statements at any depth: `import a.b as c, d`, and the module and names of `from a import b, c`.
_IMPORT = re.compile(
    r"^[ \t]*(?:import[ \t]+(.+)|from[ \t]+([\w.]+)[ \t]+import[ \t]*(\([^)]*|.+))", re.MULTILINE
)
_ALIAS = re.compile(r"\s+as\s+\w+")
_COMMENT = re.compile(r"#.*|\\\n")  # and the end of a line that goes on in the next one


def content(path: Path) -> bytes:
    """What a source file says."""
    return path.read_bytes()


@cache
def imported_files(path: Path) -> frozenset[Path]:
    """Files of this project that a module imports directly, wherever in it the import stands.

    A line of a docstring that reads like an import counts as one.
    """
    # patterns instead of a syntax tree, which would take longer than all else in a start but numba
    text = _COMMENT.sub("", content(path).decode())
    found: set[Path] = set()
    for modules, module, names in _IMPORT.findall(text):
        if not module:
            found = found.union(*(_sources(ROOT, name) for name in _names(modules)))
            continue
        inner = module.lstrip(".")
        above = len(module) - len(inner)  # dots of a relative import
        found |= _sources(path.parents[above - 1] if above else ROOT, inner, *_names(names))
    return frozenset(found)


def _names(listed: str) -> list[str]:
    """The names in what an import statement lists."""
    return _ALIAS.sub("", listed).replace(",", " ").strip("(").split()


@cache
def _sources(folder: Path, module: str, *names: str) -> frozenset[Path]:
    """The file below a folder that a module is, or the files that names of a package come from."""
    if folder == ROOT and module.partition(".")[0] not in OWN:
        return frozenset()
    place = folder.joinpath(*module.split("."))
    if not place.is_dir():
        return frozenset(filter(Path.is_file, [place.with_suffix(".py")]))
    package = place / "__init__.py"
    modules = (place / f"{name}.py" for name in names)
    files = [file if file.is_file() else package for file in modules] or [package]
    return frozenset(filter(Path.is_file, files))


def with_imports(files: Iterable[Path], *, but: Collection[Path] = ()) -> list[Path]:
    """The files and all that they import, directly or not, sorted.

    Args:
        files: where to begin.
        but: files to leave out, with what only they import.
    """
    waiting = list(files)
    found: set[Path] = set()
    while waiting:
        file = waiting.pop()
        if file not in found and file not in but:
            found.add(file)
            waiting += imported_files(file)
    return sorted(found)


def digest_of(*parts: Any) -> str:
    """Hash (16 hex digits) of what a result depends on.

    Args:
        parts: paths stand for the content of their files, arrays for type, shape and values, and
            all else for the JSON that `msgspec` makes of it, keys in order.
    """
    found = hashlib.sha256()
    for number, part in enumerate(parts):
        found.update(b"\0" * (number > 0))
        if isinstance(part, Path):
            found.update(content(part))
        elif isinstance(part, np.ndarray):
            found.update(f"{part.dtype}{part.shape}".encode() + np.ascontiguousarray(part).data)
        else:
            found.update(json.dumps(msgspec.to_builtins(part), sort_keys=True).encode())
    return found.hexdigest()[:16]


def code_digest(files: Iterable[Path]) -> str:
    """Hash (16 hex digits) of what the files do: comments, docstrings and layout do not matter."""
    return hashlib.sha256(b"".join(_meaning(content(path)) for path in files)).hexdigest()[:16]


@cache
def _meaning(source: bytes) -> bytes:
    """Hash of a module's syntax tree without docstrings."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef)):
            documented = ast.get_docstring(node) is not None
            del node.body[: int(documented)]
    return hashlib.sha256(ast.dump(tree).encode()).digest()


def versions() -> dict[str, str]:
    """Versions of this package, of Python and of the libraries that results depend on."""
    packages = {name: importlib.metadata.version(name) for name in _PACKAGES}
    return packages | {"python": platform.python_version()}
