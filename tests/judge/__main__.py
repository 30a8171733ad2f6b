"""`python -m tests.judge --out DIR`: what validators and importers of others say of the FMUs."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from cosim.base.errors import run_command
from minirobots.runner import parse, print_json

if TYPE_CHECKING:
    from tests.judge.tools import Artefact, Tool, Verdict

_BEGIN, _END = "<!-- python -m tests.judge -->\n", "<!-- end -->\n"


@dataclass(frozen=True, kw_only=True)
class Judge:
    """Put the FMUs before judges not written here, and say how far they agree.

    Validators look at the archives, importers simulate an experiment with one motor. Those that
    come as Python packages are asked if they are installed (group test), the others if they are
    named. A judge that is not at hand is said to be so.
    """

    out: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """Folder of the results: the FMUs, judges that are built, verdicts.json and verdicts.md."""
    fmusim_src: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Sources of the Reference FMUs, to compile fmusim of; on Debian it needs libxml2-dev,
    libminizip-dev, zlib1g-dev and libsundials-dev."""
    fmucheck_src: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Sources of the FMU Compliance Checker, which fetch the FMI Library when they are built."""
    vdmcheck_jar: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """VDMCheck of FMI 3, a Java archive."""
    page: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Page (.md) whose table of verdicts is replaced."""


def judges(options: Judge) -> "list[Tool]":
    """All judges, also those that are not at hand."""
    from tests.judge import building, tools

    def missing(option: str) -> str:
        raise tools.UserError(f"name it with {option}")

    found = [
        tools.Tool(
            "fmpy, validator",
            tools.package_version("fmpy"),
            tools.validate_by_fmpy,
            models=("VibrationMotor", "VibrationMotors"),
        ),
        tools.Tool("fmpy", tools.package_version("fmpy"), tools.simulate_by_fmpy),
        tools.Tool("ecospy", tools.package_version("ecospy"), tools.simulate_in_process("ecospy")),
        tools.Tool(
            "libcosimpy",
            tools.package_version("libcosimpy"),
            tools.simulate_in_process("libcosimpy"),
            ("2",),
        ),
    ]
    folder = options.out / "judges"
    fmusim = fmucheck = folder
    if options.fmusim_src:
        fmusim = building.build_fmusim(options.fmusim_src, folder)
    if options.fmucheck_src:
        fmucheck = building.build_fmucheck(options.fmucheck_src, folder / "fmucheck")
    jar = options.vdmcheck_jar

    def require_option(path: Path | None, option: str) -> str:
        return building.version_in(path) if path else missing(option)

    return [
        *found,
        tools.Tool(
            "fmusim",
            lambda: require_option(options.fmusim_src, "--fmusim-src"),
            tools.simulate_by_fmusim(fmusim),
        ),
        tools.Tool(
            "FMU Compliance Checker",
            lambda: require_option(options.fmucheck_src, "--fmucheck-src"),
            tools.simulate_by_fmucheck(fmucheck),
            ("2",),
        ),
        tools.Tool(
            "VDMCheck",
            lambda: require_option(jar, "--vdmcheck-jar"),
            tools.validate_by_vdmcheck(jar or folder),
            ("3",),
            ("VibrationMotor", "VibrationMotors"),
        ),
    ]


def artefacts(folder: Path) -> "list[Artefact]":
    """The FMUs of all models and standards, built for this machine."""
    from fmus.build import build_fmus
    from fmus.compiler import host_target
    from fmus.models import MODELS, STANDARDS, Fmi
    from tests.judge.tools import Artefact

    found = []
    for model in MODELS:
        paths: dict[Fmi, Path] = {fmi: folder / f"{model}_fmi{fmi}.fmu" for fmi in STANDARDS[model]}
        build_fmus(paths, [host_target()], model=model)
        found += [Artefact(model, fmi, path) for fmi, path in paths.items()]
    return found


def rows_of(verdicts: "Sequence[Verdict]") -> list[tuple[str, ...]]:
    """The table of verdicts."""
    return [
        (
            v.tool,
            v.version or "–",
            v.artefact,
            v.says,
            "–" if v.deviation is None else "0" if v.deviation == 0.0 else f"{v.deviation:.1e}",
        )
        for v in verdicts
    ]


HEADER = ("tool", "version", "artefact", "says", "deviation")


def markdown(verdicts: "Sequence[Verdict]") -> str:
    """The same as a table of a page."""
    lines = [HEADER, ("---",) * len(HEADER), *rows_of(verdicts)]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def main() -> None:
    """Command line; see `Judge`."""
    line = parse(Judge, "python -m tests.judge")
    options = line.options
    from cosim.base.progress import progress_bars
    from cosim.base.storage import replacing, write_json
    from cosim.base.table import show_texts
    from tests.judge.tools import UserError, ask

    page = options.page.read_text() if options.page else ""
    if options.page and not (_BEGIN in page and _END in page):
        raise UserError(
            f"{options.page} has no place for the table, {_BEGIN.strip()} {_END.strip()}"
        )
    with progress_bars() as progress:
        tools, fmus = judges(options), artefacts(options.out / "fmus")
        asked = [(t, a) for t in tools for a in fmus if t.takes(a)]
        verdicts = []
        for done, (tool, artefact) in enumerate(asked):
            progress("judging", done, len(asked), f"{tool.name}: {artefact.name}")
            verdicts.append(ask(tool, artefact))
        progress("judging", len(asked), len(asked))
    write_json(options.out / "verdicts.json", {"verdicts": verdicts})
    texts = {options.out / "verdicts.md": markdown(verdicts)}
    if options.page:
        before, after = page.split(_BEGIN)[0], page.split(_END)[-1]
        texts[options.page] = f"{before}{_BEGIN}{markdown(verdicts)}{_END}{after}"
    for path, text in texts.items():
        with replacing(path) as temporary:
            temporary.write_text(text)
    show_texts(HEADER, rows_of(verdicts), numbers=1, names=3)
    print(f"results in {options.out}/: verdicts.json, verdicts.md")
    if line.json:
        print_json({"verdicts": verdicts})
    if any(verdict.agrees is False for verdict in verdicts):
        raise UserError("a judge does not agree; see the table")


if __name__ == "__main__":
    run_command(main)
