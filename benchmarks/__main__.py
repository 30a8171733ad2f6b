"""`python -m benchmarks NAME`: what things cost, how they converge, and what helps.

A benchmark is a module with `Options`, its command line (its help is the module's docstring), and
`measure`, which takes them and returns figures by name, and rows that are shown as tables.
"""

import sys
from importlib import import_module
from pathlib import Path
from typing import Any

from cosim.base.errors import USER_ERROR_STATUS, run_command
from cosim.base.progress import progress_bars, under_way
from cosim.base.table import format_value, show_texts
from minirobots.runner import parse, print_json

ROOT = Path(__file__).parent


def main() -> None:
    """Run the benchmark that the arguments name, or say which there are."""
    files = (path for path in sorted(ROOT.glob("[a-z]*.py")) if "Options(" in path.read_text())
    known = {path.stem.replace("_", "-"): path for path in files}
    name, *rest = sys.argv[1:] or ["--help"]
    if name not in known:
        print("usage: python -m benchmarks NAME [OPTIONS]   (NAME --help lists them)\n")
        for benchmark, path in known.items():
            purpose = path.read_text().splitlines()[0].strip('"')
            print(f"  {benchmark:<16}{purpose}")
        sys.exit(0 if name in {"-h", "--help"} else USER_ERROR_STATUS)
    module = import_module(f"benchmarks.{known[name].stem}")
    module.Options.__doc__ = module.__doc__
    line = parse(module.Options, f"python -m benchmarks {name}", rest)
    with progress_bars() as progress, under_way(progress, f"benchmark {name}"):
        found = module.measure(line.options)
    _show(found)
    if line.json:
        print_json(found)


def _show(found: Any) -> None:
    """Print figures by name, and rows and records as tables."""
    if not isinstance(found, dict) or _records(found):
        found = {"": found}
    for name, value in found.items():
        rows = [{"": key, **row} for key, row in value.items()] if _records(value) else value
        if isinstance(rows, list) and rows and isinstance(rows[0], dict):
            keys = list(dict.fromkeys(key for row in rows for key in row))
            texts = [key for key in keys if isinstance(rows[0].get(key), str)]
            keys = [*texts, *(key for key in keys if key not in texts)]
            cells = [[_text(row.get(key)) for key in keys] for row in rows]
            header = [key.replace("_", " ") for key in keys]
            show_texts(header, cells, names=len(texts), title=name or None)
        else:
            print(f"{name:32} {_text(value):>14}")


def _records(value: Any) -> bool:
    return isinstance(value, dict) and all(isinstance(row, dict) for row in value.values())


def _text(value: Any) -> str:
    if isinstance(value, list | tuple):
        return " ".join(map(_text, value))
    if isinstance(value, dict):
        return ", ".join(f"{name} {_text(part)}" for name, part in value.items())
    return format_value(value, "{:,.4g}" if isinstance(value, float) else "{}")


if __name__ == "__main__":
    run_command(main)
