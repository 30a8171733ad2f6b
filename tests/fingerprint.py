"""What lines and files hold, by what it is of, in short: equal content is equal, differences show.

Of arrays, pictures and columns: their size, their mean, and the mean weighted by a ramp, which
notices another order.
"""

import hashlib
import json
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from PIL import Image, ImageSequence
from rerun.chunk import RrdReader

from cosim.base.storage import write_json

_NAMELESS = re.compile(r"[0-9a-f]{8}-[0-9a-f-]{27}")  # parts of blueprints
_PAYLOAD = re.compile(r'<script[^>]*type="application/json"[^>]*>(.*?)</script>', re.DOTALL)
_CODE = re.compile(r"<(script|style).*?</(script|style)>", re.DOTALL)
GOLDEN = Path(__file__).with_name("golden")
# What differs between machines and times: in names of parts, and in texts.
CHANGING = re.compile(
    "wall|version|created|digest|recording_id|origin|realtime|root_container|seconds|sqlite|bytes"
)
CHANGING_TEXT = re.compile(
    r"[Vv]ersions: .*|[\d.]+ MB|\d+(\.\d+)? +(?=episodes/ep_)|\d+(?= s; results)"
    r"|(?<=-)[0-9a-f]{16}(?=-)|time on \d+|[\d.]+ s(?=</td><td>\d*</td><td></td>)"
)
FEW, MANY = 3, 100  # parts and lines that stand in a file as they are
_LONG = 2000  # characters of a line that is data


def fingerprint(folder: Path, text: str) -> dict[str, Any]:
    """Return what was printed and what was written into a folder."""
    found: dict[str, Any] = {}
    for k, line in enumerate(text.splitlines()):
        found |= leaves("json", json.loads(line)) if line[:1] == "{" else {f"line {k}": line}
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            found |= dict(parts(path, str(path.relative_to(folder))))
    return found


def summary(values: np.ndarray) -> list[Any]:
    """Size, mean and weighted mean of numbers; what is not finite counts as such."""
    flat = np.asarray(values, dtype=float).ravel()
    finite = np.isfinite(flat)
    known = np.where(finite, flat, 0.0)
    weights = np.linspace(1.0, 2.0, len(flat))
    means = [known.mean(), (weights * known).mean()] if len(flat) else []
    noise = 1e-12 * np.abs(known).max(initial=0.0)  # of rounding, which processors do differently
    return [list(values.shape), int((~finite).sum()), *(_rounded(mean, noise) for mean in means)]


def _rounded(value: float, noise: float = 1e-15) -> float:
    return 0.0 if abs(value) <= noise else float(f"{value:.7g}")


def parts(path: Path, name: str) -> Iterator[tuple[str, Any]]:
    """Content of a file, by what it is of; settings are left out."""
    match path.suffix:
        case ".json":
            yield from leaves(name, json.loads(path.read_text("utf-8"))).items()
        case ".npz":
            with np.load(path) as arrays:
                for key in set(arrays.files) - {"config"}:
                    yield f"{name} {key}", _of_any(arrays[key])
        case ".rrd":
            yield from ((f"{name} {key}", value) for key, value in recorded(path).items())
        case ".csv" | ".parquet":
            table = pd.read_csv(path) if path.suffix == ".csv" else pd.read_parquet(path)
            for column in table:
                yield f"{name} {column}", _of_any(table[column].to_numpy())
        case ".html":
            page = path.read_text("utf-8")
            for payload in _PAYLOAD.findall(page):
                yield from leaves(name, json.loads(payload)).items()
            yield from _lines(name, _CODE.sub("", page))
        case ".md" | ".svg" | ".toml" | ".txt":
            yield from _lines(name, path.read_text("utf-8"))
        case ".png" | ".gif":
            with Image.open(path) as picture:
                frames = [
                    np.asarray(frame.convert("RGB")) for frame in ImageSequence.Iterator(picture)
                ]
            yield name, summary(np.stack(frames))
        case ".pdf":
            yield name, None
        case _:
            yield name, _hash(path.read_bytes())


def recorded(path: Path) -> dict[str, Any]:
    """Return every column of a recording and of its blueprint, by entity and component."""
    reader, columns = RrdReader(str(path)), dict[str, list[Any]]()
    for store in (*reader.recordings(), *reader.blueprints()):
        for chunk in reader.stream(store=store):
            batch = chunk.to_record_batch()
            entity = _NAMELESS.sub("*", chunk.entity_path)
            for name in batch.schema.names:
                if name.startswith(("rerun.controls", "log_t", "blueprint")):
                    continue
                for part, array in _flat(name, batch.column(name)):
                    columns.setdefault(f"{store.kind} {entity} {part}", []).append(array)
    return {key: _of_chunks(parts) for key, parts in columns.items()}


def _of_chunks(parts: list[pa.Array]) -> Any:
    if pa.types.is_string(parts[0].type):
        texts = sorted(_NAMELESS.sub("*", str(text)) for part in parts for text in part.to_pylist())
        return _of_any(np.array(texts))
    if pa.types.is_null(parts[0].type):
        return None
    values = np.concatenate([np.asarray(part.to_numpy(zero_copy_only=False)) for part in parts])
    return summary(np.sort(values.astype(float)) if len(parts) > 1 else values.astype(float))


def _flat(name: str, array: Any) -> Iterator[tuple[str, pa.Array]]:
    """Return the plain columns in a nested one."""
    kind = array.type
    if pa.types.is_struct(kind):
        for k, field in enumerate(kind):
            yield from _flat(f"{name}.{field.name}", array.field(k))
    elif pa.types.is_union(kind):
        yield name, pa.array([str(value) for value in array.to_pylist()])
    elif pa.types.is_nested(kind):
        yield from _flat(name, array.flatten())
    elif pa.types.is_temporal(kind):
        yield name, array.cast(pa.int64())
    else:
        yield name, array


def _of_any(values: np.ndarray) -> Any:
    if values.dtype.kind in "biuf":
        return summary(values)
    texts = [str(value) for value in values.ravel()]
    return texts if sum(map(len, texts)) < _LONG else [len(texts), _hash("\n".join(texts).encode())]


def _lines(name: str, text: str) -> Iterator[tuple[str, str]]:
    for k, line in enumerate(text.splitlines()):
        yield f"{name} {k}", line if len(line) < _LONG else _hash(line.encode())


def leaves(name: str, content: Any) -> dict[str, Any]:
    """Return every value of nested dicts, lists and tuples, by its path."""
    if isinstance(content, np.ndarray):
        return {name: content.tolist() if content.size <= FEW else _of_any(content)}
    if isinstance(content, float):
        content = _rounded(content)
    if not isinstance(content, dict | list | tuple):
        text = isinstance(content, str) and len(content) >= _LONG
        return {name: _hash(content.encode()) if text else content}
    numbers = isinstance(content, list) and len(content) > 2 * FEW
    if numbers and all(isinstance(value, int | float) for value in content):
        return {name: summary(np.array(content, dtype=float))}
    pairs = content.items() if isinstance(content, dict) else enumerate(content)
    return {k: v for key, value in pairs for k, v in leaves(f"{name} {key}", value).items()}


def _hash(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:16]


def changes(name: str, found: dict[str, Any]) -> list[str]:
    """Return what differs from a golden file; with GOLDEN=write in the environment, write it."""
    path = GOLDEN / f"{name}.json"
    found = {_lasting(key): _lasting(value) for key, value in found.items()}
    found = _short({key: value for key, value in found.items() if not CHANGING.search(key)})
    if os.environ.get("GOLDEN") == "write":
        write_json(path, dict(sorted(found.items())))
    expected = json.loads(path.read_text("utf-8"))
    return [
        f"{key}: {expected.get(key)} → {found.get(key)}"
        for key in sorted(expected.keys() | found.keys())
        if not _same(expected.get(key), found.get(key))
    ]


def _lasting(part: Any) -> Any:
    return CHANGING_TEXT.sub("…", part.rstrip()) if isinstance(part, str) else part


def _short(found: dict[str, Any]) -> dict[str, Any]:
    """Printed lines as they are, and other parts together where one thing has many of them."""
    lines = [text for key, text in found.items() if key.startswith("line ")]
    groups = dict[str, dict[str, Any]]()
    for key, value in found.items():
        if not key.startswith("line "):
            head = re.match(r"\S+ [a-z]+ /\w*/?\w*|\S+( [^\d\s]\S*)?", key)
            groups.setdefault(head[0] if head else key, {})[key] = value
    short: dict[str, Any] = {"printed": lines[:MANY], "printed …": _digest(lines)}
    short = short if lines else {}
    for head, parts in sorted(groups.items()):
        short |= parts if len(parts) <= FEW else {f"{head} …": _digest(dict(sorted(parts.items())))}
    return short


def _digest(parts: Any) -> list[Any]:
    text = json.dumps(parts, default=lambda value: f"{value:.7g}")
    return [len(parts), hashlib.sha256(text.encode()).hexdigest()[:16]]


def _same(a: Any, b: Any) -> bool:
    if isinstance(a, float) and isinstance(b, float):
        return a == pytest.approx(b, rel=1e-6, abs=1e-12, nan_ok=True)
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(map(_same, a, b))
    return a == b
