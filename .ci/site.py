"""Hook of mkdocs.yml: pages from files outside docs/, and one reference page per package.

The first page shows robots that drive in it, if docs/play.html was written before
(`uv run minirobots web --scenario 4 --method shortest --out docs/play.html`).

A link is written as it works in the repository. On the site it leads to the page made of the file,
and a link to a file that is no page becomes the words alone.
"""

import os
import re
from pathlib import Path, PurePosixPath

from griffe import Extension, Object
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[1]
PACKAGES = ("minirobots", "cosim", "agent", "analysis", "fmus")
PAGES = {
    "README.md": "readme.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "SECURITY.md": "security.md",
    "minirobots/commands.md": "commands.md",
    "fmus/vibration_motor/README.md": "motor.md",
    "fmus/vibration_motors/README.md": "motors.md",
}
SOURCES = {page: source for source, page in PAGES.items()}
EMBEDDED = (
    "## Watch robots drive\n\nThe co-simulation, computed in your browser:\n\n"
    '<iframe src="play.html" title="Robots that drive in this page" '
    'loading="lazy" style="width: 100%; height: 64rem; border: 0"></iframe>\n\n'
)
# An entry of a docstring's section that describes several names at once, "x, y: position".
SHARED = re.compile(r"^( {4,8})(\w+(?:, \w+)+):(.*(?:\n\1 +\S.*)*)", re.MULTILINE)
LINK = re.compile(r"(!?)\[([^\]]*)\]\((?!\w+:|#)([^)#\s]+)(#[^)\s]*)?\)")


def _reference() -> dict[str, list[str]]:
    """Modules of every folder that has any, by the folder's dotted name."""
    pages = {}
    for init in sorted(file for top in PACKAGES for file in ROOT.glob(f"{top}/**/__init__.py")):
        package = ".".join(init.parent.relative_to(ROOT).parts)
        modules = [f.stem for f in sorted(init.parent.glob("*.py")) if f.stem[0] != "_"]
        if modules:
            pages[package] = [f"{package}.{module}" for module in modules]
    return pages


def on_config(config: MkDocsConfig) -> None:
    """Fill the section Reference of the navigation, by package."""
    section = next(entry["Reference"] for entry in config.nav or [] if "Reference" in entry)
    for top in PACKAGES:
        names = [name for name in _reference() if name.split(".")[0] == top]
        section.append({top: [{name: f"reference/{name}.md"} for name in names]})


def on_files(files: Files, config: MkDocsConfig) -> None:
    """Add the pages that docs/ lacks."""
    for source, page in PAGES.items():
        files.append(File.generated(config, page, content=(ROOT / source).read_text("utf-8")))
    for package, modules in _reference().items():
        first = f"::: {package}\n    options: {{heading_level: 1}}"
        content = "\n\n".join([first, *(f"::: {module}" for module in modules)])
        files.append(File.generated(config, f"reference/{package}.md", content=content))


def on_page_markdown(markdown: str, page: Page, files: Files, **_: object) -> str:
    """Lead every link to the page of its file."""
    here = page.file.src_uri
    folder = PurePosixPath(SOURCES.get(here, f"docs/{here}")).parent

    def linked(match: re.Match[str]) -> str:
        image, text, target, anchor = match.groups(default="")
        source = os.path.normpath(folder / target)
        uri = PAGES.get(source, source.removeprefix("docs/"))
        if files.get_file_from_path(uri) is None and not (ROOT / source).exists():
            return match[0]  # broken, which the strict build says
        if files.get_file_from_path(uri) is None:
            return f"`{text.strip('`')}`"
        return f"{image}[{text}]({os.path.relpath(uri, PurePosixPath(here).parent)}{anchor})"

    written = LINK.sub(linked, markdown)
    if here == "index.md" and files.get_file_from_path("play.html"):
        return written.replace("\n![", f"\n{EMBEDDED}![", 1)
    return written


class SharedEntries(Extension):
    """Gives every name of a shared entry of a docstring the entry's words and its own type."""

    def on_object(self, *, obj: Object, **_: object) -> None:
        """Repeat the entry for each of its names."""
        if obj.docstring:
            obj.docstring.value = SHARED.sub(
                lambda entry: "\n".join(f"{entry[1]}{n}:{entry[3]}" for n in entry[2].split(", ")),
                obj.docstring.value,
            )
