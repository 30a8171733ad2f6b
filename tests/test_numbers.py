"""Pages read complete: numbers and code stand in them, as written from results and sources."""

import json
import re
import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
WRITER = runpy.run_path(str(ROOT / ".ci" / "pages.py"))
NUMBER = WRITER["NUMBER"]
FILES = sorted((ROOT / "docs" / "results").glob("*.json"))
PAGES = {path.relative_to(ROOT).as_posix(): path.read_text("utf-8") for path in WRITER["pages"]()}
PLAIN = {name: " ".join(WRITER["plain"](page).split()) for name, page in PAGES.items()}
# Quantities that pages are likely to repeat, each with the words around its value.
QUANTITIES = {
    "speed of one pair": r"([\d.]+) times as fast as real time",
    "speed of a batch": r"pairs together give (\d+) robot-seconds",
    "drive speed": r"(?:default drive speed stays|it drives|a turn(?: at|,)) ([\d.]+) mm/s",
    "episodes": r"(\d[ \d]+) episodes of method `paper`|all 20 runs of (\d[ \d]+) episodes",
    "paper in scenario 4": r"Q-learning succeeds in ([\d.]+ \[.*?\] %)|([\d.]+ \[[^]]*\] %) of 4 ",
    "groups without the shield": r"(\d+ of \d+) without it|without it in (\d+ of \d+)",
    "groups with the shield": r"(\d+ of \d+) episodes with the shield",
    "claim": r"certified by (\d+) episodes|all (\d+) episodes of a \[claim",
    "lift-off": r"√\(W/u\) = (\d+)|motors in phase is at \[?(\d+)|leaves the floor at (\d+)",
    "step of the platform": r"Table II(?: gives)? ([\d.]+) µm",
    "motor to 90 %": r"to 90 %: (\d+) ms|closed loop (\d+) ms to 90 %",
    "large board": r"more than (\d+) cells",
    "first command": r"takes ((?:half )?an? minute) on two cores",
    "tests": r"(?:runs the tests in|it takes) ([\w ]+? minutes)",
    "swarm": r"(?:up to|at most) (\d+) robots(?: by their number|\.|; )",
}


def _leaves(values: dict, above: str = "") -> dict[str, str]:
    """Values of a results file by their dotted names."""
    leaves: dict[str, str] = {}
    for name, value in values.items():
        deeper = _leaves(value, f"{name}.") if isinstance(value, dict) else {name: str(value)}
        leaves |= {above + key: leaf for key, leaf in deeper.items()}
    return leaves


@pytest.mark.parametrize("page", PAGES)
def test_a_page_has_the_present_numbers_and_code(page):
    assert WRITER["written"](PAGES[page]) == PAGES[page], "run `uv run python .ci/pages.py`"
    assert "{{" not in PAGES[page]
    assert "--8<--" not in PAGES[page]
    text = re.sub(r"^```.*?^```", "", PAGES[page], flags=re.DOTALL | re.MULTILINE)
    inline = [part for block in text.split("\n\n") for part in block.split("`")[1::2]]
    assert [part for part in inline if "<!--" in part] == [], "code shows comments"
    ends = r"^ *<!--[\w-]+\..*|^ +\d+\. .*"  # lines before which a paragraph ends
    assert re.findall(ends, text, re.MULTILINE) == []


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_results_are_used_and_have_a_command_that_a_page_shows(file):
    values = json.loads(file.read_text("utf-8"))
    command = values.pop("command")
    assert any(command in page for page in PLAIN.values()), command
    used = {m[2] for page in PAGES.values() for m in NUMBER.finditer(page) if m[1] == file.stem}
    assert used == _leaves(values).keys()


def _values(page: str) -> set[str]:
    return {match[3] for match in NUMBER.finditer(page)}


def test_results_are_not_written_by_hand_on_other_pages():
    found = []
    for page in PAGES.values():
        for match in NUMBER.finditer(page):
            text = match[3] if match[1] != "claims" else ""  # words that any page may have
            if len(text) <= 5:  # a short value means something with its unit alone
                unit = re.match(r" [^\s|.,;:)]+", page[match.end() :])
                text = text + unit[0] if unit else ""
            alone = re.compile(rf"(?<![\d.]){re.escape(text)}(?!\w)")
            others = {name for name, other in PAGES.items() if match[3] not in _values(other)}
            found += [(name, text) for name in others if text and alone.search(PLAIN[name])]
    assert found == []


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_a_quantity_has_one_value(quantity):
    values = {
        "".join(match.groups(default="")).strip(): name
        for name, page in PLAIN.items()
        for match in re.finditer(QUANTITIES[quantity], page)
    }
    assert len(values) == 1, f"{quantity}: {values}"


def test_what_results_and_sources_lack_is_an_error():
    with pytest.raises(KeyError):
        WRITER["written"]("<!--platform.none-->1<!--/-->")
    with pytest.raises(ValueError, match="0 places 'begin none'"):
        WRITER["written"]("<!--agent/mdp/grid.py:none-->\n```python\n\n```\n")
