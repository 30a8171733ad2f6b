"""`python -m benchmarks NAME`: what things cost, how they converge, and what helps.

A benchmark is a module with `Options`, its command line; `measure`, whose arguments these are; and
`show`, which prints what was measured: without it, the figures by name.
"""

import sys
from importlib import import_module
from pathlib import Path

from cosim.base.command import parse, print_json
from cosim.base.errors import USER_ERROR_STATUS, run_command
from cosim.base.progress import progress_bars, under_way

ROOT = Path(__file__).parent


def main() -> None:
    """Run the benchmark that the arguments name, or say which there are."""
    files = (path for path in sorted(ROOT.rglob("[a-z]*.py")) if "Options(" in path.read_text())
    known = {path.stem.replace("_", "-"): path for path in files}
    name, *rest = sys.argv[1:] or ["--help"]
    if name not in known:
        print("usage: python -m benchmarks NAME [OPTIONS]   (NAME --help lists them)\n")
        for benchmark, path in known.items():
            purpose = path.read_text().splitlines()[0].strip('"')
            print(f"  {benchmark:<16}{purpose}")
        sys.exit(0 if name in {"-h", "--help"} else USER_ERROR_STATUS)
    place = known[name].relative_to(ROOT.parent).with_suffix("")
    module = import_module(".".join(place.parts))
    options = parse(module.Options, f"benchmarks {name}", rest)
    with progress_bars() as progress, under_way(progress, f"benchmark {name}"):
        found = module.measure(**options.arguments())
    getattr(module, "show", _show)(found)
    if options.json:
        print_json(found)


def _show(figures: dict[str, float]) -> None:
    """Print figures by name."""
    for name, value in figures.items():
        print(f"{name:32} {value:14,.4g}")


if __name__ == "__main__":
    run_command(main)
