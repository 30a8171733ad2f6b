"""Hook of mkdocs.yml: `{{FILE.key}}` in a page becomes that value of docs/results/FILE.json.

A file has what its `command` measured, as pages print it. `tests/test_numbers.py` reads the pages
with the same function.
"""

import json
import re
from functools import reduce
from pathlib import Path

RESULTS = Path(__file__).parents[1] / "docs" / "results"
INSERTED = re.compile(r"\{\{([\w-]+)\.([\w.-]+)\}\}")


def inserted(match: re.Match[str]) -> str:
    """Return the value that a match of `INSERTED` names; an unknown name is a `KeyError`."""
    file, key = match.groups()
    values = json.loads((RESULTS / f"{file}.json").read_text("utf-8"))
    return str(reduce(lambda value, name: value[name], key.split("."), values))


def on_page_markdown(markdown: str, **_: object) -> str:
    """Return a page with its values."""
    return INSERTED.sub(inserted, markdown)
