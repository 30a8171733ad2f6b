"""What pages and help texts say, against the code and the commands that they name."""

import ast
import re
import runpy
import tokenize
from collections import Counter, defaultdict
from pathlib import Path

import gymnasium

import agent.envs  # noqa: F401 - which registers them
from agent.training.methods import METHODS
from analysis.figures import fig07
from analysis.motor.loop_options import StepTest
from analysis.motor.step_test import record
from analysis.reading.motor_test import read
from analysis.reading.results import FIGURES
from cosim.model.built_in import BUILT_IN
from minirobots.__main__ import purposes

ROOT = Path(__file__).parents[1]
PRODUCT = ("fmus", "cosim", "agent", "analysis", "minirobots")
# Words that CONTRIBUTING.md has others for, as a part of an identifier.
FORBIDDEN = re.compile(
    r"(^|_)(identif(y|ied)|transitions?|roll_?outs?|ways?)(_|$)|^_*timed_", re.IGNORECASE
)
# Identifiers with another "way", or of a library.
NO_PATHS = {"record_transition", "under_way"}
# Where robots are.
IDENTIFICATION = (
    "cosim/machine/identification/",
    "minirobots/commands/identify_robot.py",
)
HOMONYMS: set[str] = set()  # class names that more than one module may have
# Idioms that shall not come back; the files of fmus/ are part of what FMUs are known by.
IDIOMS = re.compile(
    r"\b(anew|as ever|beside|by itself|for ever|goes on|held (against|to)|holds? before"
    r"|in a sentence|in the small|in words|(is|are) told|made again|mend(s|ed)?|nobody|so many"
    r"|somebody|taken back|to and fro|what is there|whoever"
    r"|whose(?! (in|if|else)\b|[:\"}]))\b",  # but for a variable of that name
    re.IGNORECASE,
)
NUMBER = re.compile(r"\d+")
TAG = re.compile(r"^ *(?:#|//|/\*|\*) ?(.*)$")


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
    """Equations and files of the table in docs/architecture.md."""
    page = (ROOT / "docs" / "architecture.md").read_text("utf-8")
    rows = []
    for equations, places in re.findall(r"^\| (\(\d+\).*?) \| (.*) \|$", page, re.MULTILINE):
        numbers = [int(n) for n in re.findall(r"\((\d+)\)", equations)]
        span = " to " in equations.split("over")[0]
        files = [ROOT / name for name in re.findall(r"`([\w/]+\.\w+)`", places)]
        rows.append((set(range(numbers[0], numbers[-1] + 1)) if span else set(numbers), files))
    return rows


def test_every_equation_is_tagged_where_the_architecture_page_says():
    rows = _rows()
    assert set().union(*(equations for equations, _ in rows)) == set(range(1, 15))
    for equations, files in rows:
        missing = equations - set().union(*(_tagged(file) for file in files))
        assert not missing, f"{[str(f.relative_to(ROOT)) for f in files]} lack {missing}"


def test_the_page_of_the_paper_leaves_nothing_out():
    page = (ROOT / "docs" / "paper.md").read_text("utf-8")
    equations, tables, figures, _, _ = re.split(r"^## ", page, flags=re.MULTILINE)[1:]
    rows = {
        int(n)
        for row in re.findall(r"^\| (\(.*?\)) \|", equations, re.M)
        for n in NUMBER.findall(row)
    }
    assert rows == set(range(1, 15))
    assert re.findall(r"^\| (I+) \|", tables, re.M) == ["I", "II"]
    assert [int(n) for n in re.findall(r"^\| (\d+) ", figures, re.M)] == list(range(1, 13))
    assert {*re.findall(r"`(fig\d+)`", figures)} == {name for name in FIGURES if name[3:].isdigit()}


def test_fig07_prints_what_the_reproduction_page_says(motor_fmu, tmp_path):
    page = (ROOT / "docs" / "reproduction.md").read_text("utf-8")
    ((rise_ms, early_rad_s, end_s),) = re.findall(
        r"closed loop (\d+) ms to 90 %, (\d+) rad/s after 50 ms, ([\d.]+) s to 98 %", page
    )
    record(tmp_path / "test.rrd", motor_fmu, StepTest())
    numbers = fig07.caption(read(tmp_path / "test.rrd")).numbers
    assert round(1e3 * numbers["closed_loop_to_90_percent_s"]) == int(rise_ms)
    assert round(numbers["closed_loop_early_rad_s"]) == int(early_rad_s)
    assert round(numbers["closed_loop_to_98_percent_s"], 2) == float(end_s)


def _files(*folders: str) -> list[Path]:
    return [file for folder in folders for file in sorted((ROOT / folder).rglob("*.py"))]


def test_identifiers_use_the_words_of_the_contributors_page():
    assert FORBIDDEN.search("find_way")
    found: dict[str, set[str]] = defaultdict(set)
    for file in _files(*PRODUCT, "benchmarks"):
        place = str(file.relative_to(ROOT))
        with tokenize.open(file) as lines:
            for token in tokenize.generate_tokens(lines.readline):
                words = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", token.string)
                if "identif" in words.lower() and place.startswith(IDENTIFICATION):
                    continue
                if token.type == tokenize.NAME and FORBIDDEN.search(words):
                    found[token.string].add(place)
    assert {name: places for name, places in found.items() if name not in NO_PATHS} == {}


def test_no_two_classes_have_one_name():
    trees = [ast.parse(file.read_bytes()) for file in _files(*PRODUCT)]
    classes = (node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.ClassDef))
    counts = Counter(node.name for node in classes)
    assert {name for name, count in counts.items() if count > 1} == HOMONYMS


def test_commands_page_names_commands_that_exist():
    page = (ROOT / "minirobots" / "commands.md").read_text("utf-8")
    shown = set(re.findall(r"minirobots ([a-z][a-z-]+)", page))
    assert shown - {*purposes()} == set()
    assert len(shown) > 20


def test_the_architecture_page_has_every_folder_and_no_other():
    page = (ROOT / "docs" / "architecture.md").read_text("utf-8")
    rows = re.findall(r"^\| (`[a-z][^|]*) \| [^|]* \| [^|]* \|$", page, re.MULTILINE)
    named = {name for row in rows for name in re.findall(r"`([\w/.]+)`", row)}
    assert [name for name in named if not (ROOT / name).exists()] == []
    files = [file for file in _files(*PRODUCT) if file.name != "__init__.py"]
    folders = {str(file.parent.relative_to(ROOT)) for file in files}
    inner = {name for name in folders if "/" in name and not name.startswith("fmus/")}
    missing = {name for name in inner if not named & {name, *map(str, Path(name).parents)}}
    assert missing == set()


def test_prose_is_plain_english():
    pages = [*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), *ROOT.glob("fmus/*/README.md")]
    code = [path for top in (*PRODUCT[1:], "benchmarks") for path in ROOT.glob(f"{top}/**/*.py")]
    found = [
        f"{path.relative_to(ROOT)}: {line.strip()}"
        for path in pages + code
        if path.name not in {"CHANGELOG.md", "built_in.py", "gallery.md", "episode.py"}  # titles
        for line in path.read_text("utf-8").splitlines()
        if IDIOMS.search(line)
    ]
    assert found == []


def test_docstrings_begin_with_what_is_returned_or_done():
    found = []
    for file in _files(*PRODUCT, "benchmarks"):
        for node in ast.walk(ast.parse(file.read_bytes())):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
                first = (ast.get_docstring(node) or "").partition("\n")[0]
                if re.match(r"(How|The same|What|When|Where|Whether|Who|Whose|Why)\b", first):
                    found.append(f"{file.relative_to(ROOT)}: {first}")
    assert found == []


def test_methods_page_has_the_table_of_the_command():
    page = (ROOT / "docs" / "methods.md").read_text("utf-8").replace("`", "")
    rows = [f"| {name} | {' | '.join(method.facts.values())} |" for name, method in METHODS.items()]
    assert [row for row in rows if row not in page] == []


def test_every_page_says_first_what_it_is_for():
    pages = [path for path in (ROOT / "docs").glob("*.md") if path.name != "index.md"]
    lines = {path.name: path.read_text("utf-8").splitlines() for path in pages}
    assert [n for n, text in lines.items() if not text[2].startswith("For ") or text[1]] == []
    site = (ROOT / "mkdocs.yml").read_text("utf-8")
    assert [path.name for path in pages if f": {path.name}" not in site] == []


def test_pages_of_results_open_with_a_picture():
    pages = {path.stem: path.read_text("utf-8") for path in (ROOT / "docs").glob("*.md")}
    results = {name: text.splitlines()[:20] for name, text in pages.items() if "**Result**" in text}
    assert len(results) > 5
    without = [name for name, top in results.items() if not any("![" in line for line in top)]
    assert sorted(without) == ["reliability", "shield"]  # their results are tests


def test_pictures_show_what_the_tables_say():
    tables = runpy.run_path(str(ROOT / ".ci" / "tables.py"))
    pictures = ROOT / "docs" / "images"
    for name, picture in tables["PICTURES"].items():
        said = str(tables["read_rows"](picture))
        assert tables["drawn_from"](pictures / f"{name}.png") == said, f"draw {name}.png again"
        assert f"(images/{name}.png)" in (ROOT / "docs" / f"{picture.page}.md").read_text("utf-8")


def test_gallery_has_every_scenario():
    page = (ROOT / "docs" / "gallery.md").read_text("utf-8")
    rows = [f"| `{name}` | {s.title} |" for name, s in BUILT_IN.items() if "-zone" not in name]
    assert [row for row in rows if row not in page] == []
    assert [
        spec for spec in gymnasium.registry if "MiniRobots" in spec and spec[-9:] not in page
    ] == []
