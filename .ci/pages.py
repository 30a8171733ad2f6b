"""Write numbers and code into the pages: `uv run python .ci/pages.py`.

`<!--FILE.key-->value<!--/-->` in a page has that value of docs/results/FILE.json, a file with what
its `command` measured. `<!--FILE:name-->` above a block of code has it from FILE, between its
lines `begin name` and `end name`. In rows of a table that begin with the number of an equation,
links to sources lead to the line of its tag. `tests/test_numbers.py` fails on pages that this would
change.

With the claims.json of a report, `uv run python .ci/pages.py runs/reproduction/report/claims.json`,
its verdicts become docs/results/claims.json, and so those of docs/paper.md.
"""

import json
import re
import sys
import textwrap
from functools import reduce
from pathlib import Path

ROOT = Path(__file__).parents[1]
NUMBER = re.compile(r"<!--([\w-]+)\.([\w.-]+)-->(.*?)<!--/-->")
CODE = re.compile(r"(<!--([\w./]+):(\w+)-->\n```python\n).*?(\n```\n)", re.DOTALL)
EQUATIONS = re.compile(r"^\| (\(\d+\)[^|]*) \|.*$", re.MULTILINE)
SOURCE = re.compile(r"\[`([\w./]+)`\]\(\.\./\1#L\d+\)")


def pages() -> list[Path]:
    """Return the Markdown files of the repository."""
    folders = ("", "docs/", "fmus/*/", "minirobots/")
    return sorted(file for folder in folders for file in ROOT.glob(f"{folder}*.md"))


def keep_verdicts(report: Path) -> None:
    """Write docs/results/claims.json: the verdicts of a report, by the beginnings of claims."""
    rows = [row for row in json.loads(report.read_text("utf-8")) if row["figure"]]
    if brief := [row["paper"] for row in rows if row["brief"]]:
        raise SystemExit(f"{report}: brief results test no claim: {brief}")
    kept = {"command": "uv run minirobots reproduce --out runs/reproduction"}
    for row in rows:
        name = re.sub(r"\W+", "-", row["paper"].partition(":")[0].lower())
        kept[name] = re.sub(r"(not confirmed|cannot be tested)", r"**\1**", row["verdict"])
    text = json.dumps(kept, ensure_ascii=False, indent=2)
    (ROOT / "docs/results/claims.json").write_text(text + "\n", "utf-8")


def number(file: str, key: str) -> str:
    """Return a value of docs/results/FILE.json; an unknown name is a `KeyError`."""
    values = json.loads((ROOT / f"docs/results/{file}.json").read_text("utf-8"))
    return str(reduce(lambda value, name: value[name], key.split("."), values))


def code(file: str, name: str) -> str:
    """Return the lines of a source between its marks of a name; a `ValueError` if it has none."""
    text = (ROOT / file).read_text("utf-8")
    found = re.findall(
        rf"^ *# begin {name}\n(.*?)\n *# end {name}$", text, re.DOTALL | re.MULTILINE
    )
    if len(found) != 1:
        raise ValueError(f"{file} has {len(found)} places 'begin {name}', not 1")
    return textwrap.dedent(found[0]).rstrip()


def tagged(file: str, equations: list[int]) -> int:
    """Return the line of a source, from 1, with the tag of one of some equations.

    The first one that is a comment of its own, else the first; a `ValueError` if there is none.
    """
    text = (ROOT / file).read_text("utf-8")
    tag = rf"^ *(?:#|//|/\*|\*) ?Eq\. \((?:{'|'.join(map(str, equations))})\)"
    for end in (r"(?=$|[,:]| \*/)", ""):
        if found := re.search(tag + end, text, re.MULTILINE):
            return text.count("\n", 0, found.start()) + 1
    raise ValueError(f"{file} has no tag of equation {equations}")


def linked(row: re.Match[str]) -> str:
    """Return the row of an equation with links to its lines."""
    numbers = [int(n) for n in re.findall(r"\((\d+)\)", row[1])]
    return SOURCE.sub(lambda m: f"[`{m[1]}`](../{m[1]}#L{tagged(m[1], numbers)})", row[0])


def written(text: str) -> str:
    """Return a page with the present numbers, code and lines of equations."""
    text = EQUATIONS.sub(linked, text)
    text = NUMBER.sub(lambda m: f"<!--{m[1]}.{m[2]}-->{number(m[1], m[2])}<!--/-->", text)
    return CODE.sub(lambda m: f"{m[1]}{code(m[2], m[3])}{m[4]}", text)


def plain(text: str) -> str:
    """Return a page as it reads, without the marks of numbers."""
    return NUMBER.sub(r"\3", text)


if __name__ == "__main__":
    for report in sys.argv[1:]:
        keep_verdicts(Path(report))
    for page in pages():
        before = page.read_text("utf-8")
        if (after := written(before)) != before:
            page.write_text(after, "utf-8")
            print(page.relative_to(ROOT))
