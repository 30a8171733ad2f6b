"""The identity of code: what a result depends on, without names of files and texts of messages.

A stored result is found again while the code that decides its bits is the same. That code is what a
function reaches: functions and classes that it names, constants that they read, and methods of
reached classes with names that occur in it. The hash is of their syntax without names of modules,
imports, docstrings, annotations, log lines, and without prose, which is every text with a space in
it. More may be reached than is called; less may not.
"""

import ast
import hashlib
import inspect
import re
import sys
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

ROOT = Path(__file__).parents[2]
OWN = ("fmus", "cosim", "agent", "analysis", "minirobots")  # packages of this project below ROOT

# Where files go, what is shown meanwhile and what errors look like decides no bits.
INFRASTRUCTURE = tuple(
    f"cosim.base.{name}"
    for name in (
        "errors",
        "kernel_files",
        "progress",
        "provenance",
        "reached_code",
        "reading",
        "storage",
    )
)
LOOSE = ""  # name of the statements of a module that define nothing
_WORD = re.compile(r"[^\W\d]\w*")

Reference = tuple[str, str]  # module and name in it


def code_digest(*roots: Callable | ModuleType | str, but: Collection[str] = ()) -> str:
    """Return the hash (16 hex digits) of the code that roots reach.

    Args:
        roots: functions, classes, modules, "module" or "module:name"; a module stands for all
            that it defines.
        but: names of modules that are left out, with what only they reach.
    """
    waiting = [reference for root in roots for reference in _references(root)]
    left_out = {*INFRASTRUCTURE, *but}
    reached: dict[Reference, str] = {}
    attributes: set[str] = set()
    methods: defaultdict[str, set[Reference]] = defaultdict(set)  # of reached classes, by name
    while waiting:
        module, name = waiting.pop()
        if (module, name) in reached or module in left_out:
            continue
        source = _source(module)
        found = source.definition(name)
        reached[module, name] = found.text
        waiting.append((module, LOOSE))
        waiting += (target for word in found.names for target in _resolved(module, word))
        for method in source.methods.get(name, ()):
            methods[method].add((module, f"{name}.{method}"))
            if method in attributes:
                waiting.append((module, f"{name}.{method}"))
        for attribute in found.attributes - attributes:
            attributes.add(attribute)
            waiting += methods[attribute]
    return hashlib.sha256("\0".join(sorted({*reached.values()})).encode()).hexdigest()[:16]


def _references(root: Callable | ModuleType | str) -> list[Reference]:
    if isinstance(root, ModuleType):
        root = root.__name__
    module, _, name = root.partition(":") if isinstance(root, str) else (
        root.__module__, "", root.__qualname__,
    )  # fmt: skip
    source = _source(module)
    names = [name] if name else [*source.statements]
    return [
        (module, full)
        for name in names
        for full in (name, *(f"{name}.{method}" for method in source.methods.get(name, ())))
    ]


@cache
def _path(module: str) -> Path | None:
    """Return the file of a module of this project, or of one that is loaded."""
    place = ROOT.joinpath(*module.split("."))
    for path in (place.with_suffix(".py"), place / "__init__.py"):
        if path.is_file():
            return path
    loaded = sys.modules.get(module)
    return Path(inspect.getfile(loaded)) if loaded and getattr(loaded, "__file__", None) else None


def content(path: Path) -> bytes:
    """Return the content of a source file."""
    return path.read_bytes()


@cache
def _source(module: str) -> "_Source":
    path = _path(module)
    if path is None:
        raise ModuleNotFoundError(module)
    return _parsed(content(path))


@cache
def _parsed(source: bytes) -> "_Source":
    return _Source(ast.parse(source))


def _resolved(module: str, word: str) -> Iterator[Reference]:
    """Yield what a name, or a name and an attribute with a dot between, means in a module."""
    name, _, attribute = word.partition(".")
    source = _source(module)
    if name in source.statements:
        if not attribute:
            yield module, name
        return
    target = source.imports.get(name)
    if target is None:
        return
    origin, inner = target
    submodule = _submodule(origin, inner)
    if submodule and attribute:
        yield from _resolved(submodule, attribute)
    elif not submodule and not attribute:
        yield from _resolved(origin, inner)


def _submodule(origin: str, inner: str) -> str | None:
    """Return the module that an imported name is, None if it is something in a module."""
    name = f"{origin}.{inner}" if inner else origin
    return name if _path(name) else None


class _Definition(NamedTuple):
    """The definition of a name.

    Attributes:
        text: its syntax, without what does not decide bits.
        names: that it reads, and module.attribute where a name may be a module's.
        attributes: names of attributes that it reads, and texts that may be such names.
    """

    text: str
    names: frozenset[str]
    attributes: frozenset[str]


class _Source:
    """A module, taken apart.

    Attributes:
        imports: names to the module of this project that they come from, and the name there.
        statements: that define a name; under `LOOSE` those that define none.
        methods: names of a class's methods but those that Python calls on its own.
    """

    def __init__(self, tree: ast.Module) -> None:
        self.imports: dict[str, tuple[str, str]] = {}
        self.statements: defaultdict[str, list[ast.AST]] = defaultdict(list)
        self.methods: dict[str, list[str]] = {}
        self._definitions: dict[str, _Definition] = {}
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.module and _is_own(node.module):
                for alias in node.names:
                    self.imports[alias.asname or alias.name] = node.module, alias.name
            elif isinstance(node, ast.Import):
                for alias in node.names:
                    if alias.asname and _is_own(alias.name):
                        self.imports[alias.asname] = alias.name, ""
        self.statements[LOOSE] = []
        for node in tree.body:
            self._add(node)

    def _add(self, node: ast.stmt) -> None:
        if isinstance(node, ast.ClassDef):
            inner = [f for f in node.body if isinstance(f, ast.FunctionDef)]
            named = [f for f in inner if not f.name.startswith("__")]
            self.methods[node.name] = [f.name for f in named]
            for function in named:
                self.statements[f"{node.name}.{function.name}"].append(function)
            node.body = [child for child in node.body if child not in named]
            names = [node.name]
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            names = [node.name]
        elif isinstance(node, ast.Import | ast.ImportFrom) or _is_main(node):
            return
        else:
            stored = (n for n in ast.walk(node) if isinstance(n, ast.Name))
            names = [n.id for n in stored if isinstance(n.ctx, ast.Store)]
            if not isinstance(node, ast.Assign | ast.AnnAssign) or not names:
                names.append(LOOSE)
        for name in names:
            self.statements[name].append(node)

    def definition(self, name: str) -> _Definition:
        """Return the definition of a name, empty if the module has none."""
        if name not in self._definitions:
            reader = _SyntaxReader(self.imports)
            texts = [reader.text(node) for node in self.statements.get(name, ())]
            self._definitions[name] = _Definition(
                f"{name}: {texts}" if any(texts) else "",
                frozenset(reader.names),
                frozenset(reader.attributes),
            )
        return self._definitions[name]


class _SyntaxReader:
    """Writes syntax as text and remembers the names in it."""

    def __init__(self, imports: dict[str, tuple[str, str]]) -> None:
        self._imports = imports
        self.names: set[str] = set()
        self.attributes: set[str] = set()

    def text(self, node: Any) -> str:
        """Return a node's syntax as text; what decides no bits is empty."""
        if isinstance(node, list):
            return f"[{','.join(filter(None, map(self.text, node)))}]"
        if not isinstance(node, ast.AST):
            return repr(node)
        if isinstance(node, ast.Import | ast.ImportFrom) or _is_said(node):
            return ""
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            self.attributes |= {node.value} if node.value.isidentifier() else set()
            return "prose" if " " in node.value else repr(node.value)
        if isinstance(node, ast.Raise):
            kind = node.exc.func if isinstance(node.exc, ast.Call) else node.exc
            return f"raise({self.text(kind)})"
        if isinstance(node, ast.Name):
            self.names.add(node.id)
            origin = self._imports.get(node.id)
            return "module" if origin and _submodule(*origin) else origin[1] if origin else node.id
        if isinstance(node, ast.Attribute):
            self.attributes.add(node.attr)
            if isinstance(node.value, ast.Name):
                self.names.add(f"{node.value.id}.{node.attr}")
        fields = []
        for name, value in ast.iter_fields(node):
            if name in ("annotation", "returns"):
                self._read_annotation(value)
            elif name not in ("ctx", "type_comment", "kind", "simple", "type_params"):
                fields.append(self.text(value))
        return f"{type(node).__name__}({','.join(fields)})"

    def _read_annotation(self, node: ast.AST | None) -> None:
        """Remember the classes of a function's arguments: their methods may be called."""
        for inner in ast.walk(node) if node else ():
            if isinstance(inner, ast.Name):
                self.names.add(inner.id)
            elif isinstance(inner, ast.Attribute) and isinstance(inner.value, ast.Name):
                self.names.add(f"{inner.value.id}.{inner.attr}")
            elif isinstance(inner, ast.Constant) and isinstance(inner.value, str):
                self.names.update(_WORD.findall(inner.value))


def _is_own(module: str) -> bool:
    return module.partition(".")[0] in OWN


def _is_main(node: ast.stmt) -> bool:
    """Return whether a statement is for the command line or the type checker alone."""
    if not isinstance(node, ast.If):
        return False
    return any(
        isinstance(n, ast.Name) and n.id in ("__name__", "TYPE_CHECKING")
        for n in ast.walk(node.test)
    )


def _is_said(node: ast.AST) -> bool:
    """Return whether a statement is a docstring, a text next to a field, or a line of a log."""
    if not isinstance(node, ast.Expr):
        return False
    value = node.value
    if isinstance(value, ast.Constant):
        return isinstance(value.value, str)
    function = value.func if isinstance(value, ast.Call) else None
    logger = function.value if isinstance(function, ast.Attribute) else None
    return isinstance(logger, ast.Name) and logger.id == "_LOGGER"
