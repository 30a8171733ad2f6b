"""`python -m tests.judge --out DIR`: what validators and importers of others say of the FMUs."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from cosim.base.errors import run_command
from fmus.models import MODELS, STANDARDS, Fmi
from minirobots.runner import parse, print_json

if TYPE_CHECKING:
    from tests.judge.tools import Artefact, Tool

BEGIN, END = "<!-- python -m tests.judge -->\n", "<!-- end -->\n"


@dataclass(frozen=True, kw_only=True)
class Judge:
    """Put the FMUs before judges not written here, and say how far they agree.

    Validators look at the archives, importers simulate an experiment with one motor. Those that
    come as Python packages are asked if they are installed (group test), the others if they are
    named. A judge that is not at hand is said to be so.
    """

    out: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """Folder of the results: the FMUs, verdicts.json and verdicts.md."""
    fmusim: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """fmusim of the Reference FMUs, a program."""
    fmucheck: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """FMU Compliance Checker, a program."""
    vdmcheck: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """VDMCheck of FMI 3, a Java archive."""
    page: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Page (.md) whose table of verdicts is replaced."""


def judges(options: Judge) -> "list[Tool]":
    """All judges, also those that are not at hand."""
    from tests.judge import tools
    from tests.judge.tools import Tool, package_version, version_in

    def package(name: str) -> tuple[str, str]:
        return package_version(name), f"install {name}"

    def program(option: str) -> tuple[str, str]:
        return version_in(getattr(options, option)), f"name it with --{option}"

    ecos, cosim = (partial(tools.simulate_in_process, name) for name in ("ecospy", "libcosimpy"))
    sim = partial(tools.simulate_by_fmusim, options.fmusim)
    check = partial(tools.simulate_by_fmucheck, options.fmucheck)
    vdm = partial(tools.validate_by_vdmcheck, options.vdmcheck)
    return [
        Tool("fmpy, validator", *package("fmpy"), tools.validate_by_fmpy, models=MODELS),
        Tool("fmpy", *package("fmpy"), tools.simulate_by_fmpy),
        Tool("ecospy", *package("ecospy"), ecos),
        Tool("libcosimpy", *package("libcosimpy"), cosim, ("2",)),
        Tool("fmusim", *program("fmusim"), sim),
        Tool("FMU Compliance Checker", *program("fmucheck"), check, ("2",)),
        Tool("VDMCheck", *program("vdmcheck"), vdm, ("3",), MODELS),
    ]


def artefacts(folder: Path) -> "list[Artefact]":
    """The FMUs of all models and standards, built for this machine."""
    from fmus.build import build_fmus
    from fmus.compiler import host_target
    from tests.judge.tools import Artefact

    found = []
    for model in MODELS:
        paths: dict[Fmi, Path] = {fmi: folder / f"{model}_fmi{fmi}.fmu" for fmi in STANDARDS[model]}
        build_fmus(paths, [host_target()], model=model)
        found += [Artefact(model, fmi, path) for fmi, path in paths.items()]
    return found


def main() -> None:
    """Command line; see `Judge`."""
    line = parse(Judge, "python -m tests.judge")
    options = line.options
    from cosim.base.storage import replacing, write_json
    from cosim.base.table import Column, field, markdown, show
    from tests.judge.tools import UserError, ask

    page = options.page.read_text() if options.page else ""
    if options.page and not (BEGIN in page and END in page):
        raise UserError(f"{options.page} has no place for the table, {BEGIN.strip()} {END.strip()}")
    tools, fmus = judges(options), artefacts(options.out / "fmus")
    verdicts = [ask(tool, fmu) for tool in tools for fmu in fmus if tool.takes(fmu)]
    columns = [
        field("tool"),
        Column("version", lambda row: row.version or "–"),
        field("artefact"),
        field("says"),
        field("deviation", "{:.2g}"),
    ]
    write_json(options.out / "verdicts.json", {"verdicts": verdicts})
    texts = {options.out / "verdicts.md": markdown(columns, verdicts) + "\n"}
    if options.page:
        before, after = page.split(BEGIN)[0], page.split(END)[-1]
        texts[options.page] = f"{before}{BEGIN}{markdown(columns, verdicts)}\n{END}{after}"
    for path, text in texts.items():
        with replacing(path) as temporary:
            temporary.write_text(text)
    show(columns, verdicts, numbers=1, names=3)
    print(f"results in {options.out}/: verdicts.json, verdicts.md")
    if line.json:
        print_json({"verdicts": verdicts})
    if any(verdict.agrees is False for verdict in verdicts):
        raise UserError("a judge does not agree; see the table")


if __name__ == "__main__":
    run_command(main)
