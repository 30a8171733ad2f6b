"""What pages and help texts say, against the code and the commands that they name."""

import json
import re
import runpy
import tomllib
from itertools import pairwise
from pathlib import Path

import gymnasium

import agent.envs  # noqa: F401 - which registers them
from agent.training.methods import METHODS
from analysis.figures import fig07
from analysis.figures.style import figure_entries
from analysis.motor.loop_options import StepTest
from analysis.motor.step_test import record
from analysis.reading.motor_test import read
from cosim.model.scenario_file import BUILT_IN
from minirobots.commands import COMMANDS

ROOT = Path(__file__).parents[1]
PRODUCT = ("fmus", "cosim", "agent", "analysis", "minirobots")
NUMBER = re.compile(r"\d+")
TAG = re.compile(r"^ *(?:#|//|/\*|\*) ?(.*)$")


def _page(name: str) -> str:
    return (ROOT / "docs" / f"{name}.md").read_text("utf-8")


def _tagged(path: Path) -> set[int]:
    """Equations with a tag in a comment directly above a line of code."""
    found: set[int] = set()
    pending: set[int] = set()
    for line in path.read_text("utf-8").splitlines():
        if comment := TAG.match(line):
            pending |= {int(n) for n in re.findall(r"Eq\. \((\d+)\)", comment[1])}
        else:
            found |= pending if line.strip() else set()
            pending = set()
    return found


def _rows() -> list[tuple[set[int], list[Path]]]:
    """Equations and files of the table in docs/paper.md."""
    page = _page("paper")
    rows = []
    for equations, places in re.findall(r"^\| (\(\d+\).*?) \| (.*) \|$", page, re.MULTILINE):
        numbers = [int(n) for n in re.findall(r"\((\d+)\)", equations)]
        span = " to " in equations.split("over")[0]
        files = [ROOT / name for name in re.findall(r"`([\w/]+\.\w+)`", places)]
        rows.append((set(range(numbers[0], numbers[-1] + 1)) if span else set(numbers), files))
    return rows


def test_every_equation_is_tagged_where_the_page_of_the_paper_says():
    rows = _rows()
    assert set().union(*(equations for equations, _ in rows)) == set(range(1, 15))
    for equations, files in rows:
        missing = equations - set().union(*(_tagged(file) for file in files))
        assert not missing, f"{[str(f.relative_to(ROOT)) for f in files]} lack {missing}"


def test_the_page_of_the_paper_leaves_nothing_out():
    page = _page("paper")
    *_, equations, tables, figures = re.split(r"^## ", page, flags=re.MULTILINE)
    rows = " ".join(re.findall(r"^\| (\(.*?\)) \|", equations, re.M))
    assert {int(n) for n in NUMBER.findall(rows)} == set(range(1, 15))
    assert re.findall(r"^\| (I+) \|", tables, re.M) == ["I", "II"]
    assert [int(n) for n in re.findall(r"^\| (\d+) ", figures, re.M)] == list(range(1, 13))
    assert {*re.findall(r"`(fig\d+)`", figures)} == {
        name for name in figure_entries() if name[3:].isdigit()
    }


def test_files_of_each_walk_import_each_other():
    page = _page("architecture")
    section = page[page.index("## Walks") : page.index("## Decisions")]
    for row in re.findall(r"^\| .*\.py.*$", section, re.M):
        walk: list[str] = []
        for folder, names in re.findall(r"`([\w/]+/)(\w+|{[\w,]+})\.py`", row):
            walk += [folder + name for name in names.strip("{}").split(",")]
        assert f"({len(walk)} files)" in row
        for one, other in pairwise(walk):
            assert _imports(one, other) or _imports(other, one), f"{one} and {other}"


def _imports(one: str, other: str) -> bool:
    package, _, name = other.replace("/", ".").rpartition(".")
    text = (ROOT / f"{one}.py").read_text("utf-8")
    return bool(re.search(rf"from {package}(\.{name} import| import .*\b{name}\b)", text))


def test_fig07_prints_what_the_pages_insert(motor_fmu, tmp_path):
    said = json.loads((ROOT / "docs" / "results" / "motor-test.json").read_text("utf-8"))
    record(tmp_path / "test.rrd", motor_fmu, StepTest())
    numbers = fig07.drawing_of(*read(tmp_path / "test.rrd")).numbers
    for loop in ("open", "closed"):
        to_90_s, to_98_s = (numbers[f"{loop}_loop_to_{share}_percent_s"] for share in (90, 98))
        assert round(1e3 * to_90_s) == said[loop]["to_90_ms"]
        assert round(to_98_s, 2) == said[loop]["to_98_s"]
    assert round(numbers["closed_loop_early_rad_s"]) == said["closed"]["after_50_ms_rad_s"]


def test_commands_page_names_commands_that_exist():
    page = (ROOT / "minirobots" / "commands.md").read_text("utf-8")
    shown = set(re.findall(r"minirobots ([a-z][a-z-]+)", page))
    assert shown - COMMANDS.keys() == set()
    assert len(shown) > 20


def test_the_architecture_page_has_every_folder_and_no_other():
    page = _page("architecture")
    rows = re.findall(r"^\| (`[a-z][^|]*) \| [^|]* \| [^|]* \|$", page, re.MULTILINE)
    named = {name for row in rows for name in re.findall(r"`([\w/.]+)`", row)}
    assert [name for name in named if not (ROOT / name).exists()] == []
    files = [file for folder in PRODUCT for file in (ROOT / folder).rglob("*.py")]
    folders = {str(f.parent.relative_to(ROOT)) for f in files if f.name != "__init__.py"}
    inner = {name for name in folders if "/" in name and not name.startswith("fmus/")}
    missing = {name for name in inner if not named & {name, *map(str, Path(name).parents)}}
    assert missing == set()


def test_the_table_of_folders_says_what_the_import_contracts_say():
    rows = re.findall(
        r"^\| `([\w/.]+)` \| [^|]* \| ([^|]*) \|$", _page("architecture"), re.MULTILINE
    )
    places = {name: place for place, (name, _) in enumerate(rows)}
    content = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    checked = 0
    for contract in content["tool"]["importlinter"]["contracts"]:
        layers = [
            [name.strip().replace(".", "/") for name in layer.split("|")]
            for layer in reversed(contract.get("layers", ()))
        ]
        named = [
            [n for n in (*layer, *(f"{x}.py" for x in layer)) if n in places] for layer in layers
        ]
        above: list[str] = []
        for layer in named:
            for name in layer:
                later = [other for other in above if places[other] > places[name]]
                assert later == [], f"{name} stands above {later}, which it may import"
                earlier = {other for other in layer if places[other] < places[name]}
                excluded = set(
                    re.findall(r"`([\w/.]+)`", rows[places[name]][1].partition("except")[2])
                )
                assert excluded == earlier, f"{name} may not import {earlier}"
                checked += 1
            above += layer
    assert checked > 20


def test_methods_page_has_the_table_of_the_command():
    page = _page("methods").replace("`", "")
    rows = [
        f"| {name} | {' | '.join(method.facts.values())} |"
        for name, method in METHODS.items()
        if ":" not in name
    ]
    assert [row for row in rows if row not in page] == []


def test_pictures_show_what_the_tables_say():
    tables = runpy.run_path(str(ROOT / ".ci" / "tables.py"))
    pictures = ROOT / "docs" / "images"
    for name, picture in tables["PICTURES"].items():
        said = str(tables["read_rows"](picture))
        assert tables["drawn_from"](pictures / f"{name}.png") == said, f"draw {name}.png again"
        assert f"(images/{name}.png)" in _page(picture.page)


def test_the_pages_of_scenarios_and_environments_have_all_of_them():
    scenarios, environments = _page("scenarios"), _page("environments")
    names = [name for name in BUILT_IN if "-zone" not in name]
    assert [n for n in names if f"`{n}`" not in scenarios] == []
    ids = [spec for spec in gymnasium.registry if "MiniRobots" in spec]
    assert [spec for spec in ids if spec[-9:] not in environments] == []


def _anchors(page: Path) -> set[str]:
    """Anchors of a page's headings, as repositories and the site name them."""
    text = re.sub(r"^```.*?^```", "", page.read_text("utf-8"), flags=re.DOTALL | re.MULTILINE)
    headings = [
        re.sub(r"\[([^\]]*)\]\([^)]*\)|[`*]", r"\1", heading)
        for heading in re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    ]
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_every_link_and_anchor_resolves_in_the_repository():
    broken = []
    for page in runpy.run_path(str(ROOT / ".ci" / "pages.py"))["pages"]():
        text = re.sub(r"^```.*?^```", "", page.read_text("utf-8"), flags=re.DOTALL | re.MULTILINE)
        for link in re.findall(r"\]\(([^)\s]+)\)", text):
            target, _, anchor = link.partition("#")
            file = page if not target else page.parent / target
            if re.match(r"\w+:", target):
                continue
            line = re.fullmatch(r"L(\d+)", anchor) if file.suffix != ".md" else None
            if line and file.exists() and int(line[1]) <= len(file.read_text("utf-8").splitlines()):
                continue
            if not file.exists() or (anchor and anchor not in _anchors(file)):
                broken.append((page.relative_to(ROOT).as_posix(), link))
    assert broken == []
