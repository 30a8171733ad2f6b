"""Numbers of the pages that are inserted from docs/results stand nowhere else."""

import json
import re
import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
HOOK = runpy.run_path(str(ROOT / ".ci" / "numbers.py"))
PAGES = {path.name: path.read_text("utf-8") for path in (ROOT / "docs").glob("*.md")}
FILES = sorted(path.stem for path in (ROOT / "docs" / "results").glob("*.json"))


def leaves(values: dict, before: str = "") -> dict[str, str]:
    """Values of a results file by their keys, but for its command."""
    found = {}
    for key, value in values.items():
        if isinstance(value, dict):
            found |= leaves(value, f"{before}{key}.")
        elif before + key != "command":
            found[before + key] = str(value)
    return found


@pytest.mark.parametrize("file", FILES)
def test_a_result_says_its_command_and_every_value_is_on_a_page(file):
    values = json.loads((ROOT / "docs" / "results" / f"{file}.json").read_text("utf-8"))
    assert values["command"]
    inserted = {key for page in PAGES.values() for f, key in HOOK["INSERTED"].findall(page)
                if f == file}  # fmt: skip
    assert inserted == leaves(values).keys()


def test_inserted_values_are_written_by_hand_nowhere():
    """Values with three digits or more: shorter ones are other quantities, too."""
    contradictions = []
    for file in FILES:
        values = json.loads((ROOT / "docs" / "results" / f"{file}.json").read_text("utf-8"))
        for key, value in leaves(values).items():
            if len(re.findall(r"\d", value)) >= 6:
                contradictions += [(file, key, n) for n, p in PAGES.items() if value in p]
    assert not contradictions


def test_a_name_that_no_file_has_is_an_error():
    page = HOOK["on_page_markdown"]("from {{platform.step_um}} µm")
    assert "{{" not in page
    with pytest.raises(KeyError):
        HOOK["on_page_markdown"]("{{platform.none}}")
