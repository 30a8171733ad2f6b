"""The report from small results: what it says, what it refuses, and in a browser."""

import io
import re
import shutil
import threading

import msgspec
import numpy as np
import pytest
from markupsafe import escape
from PIL import Image
from playwright.sync_api import sync_playwright

from analysis.figures.style import Caption, read_caption, write_caption
from analysis.reading.results import FIGURES
from analysis.reading.written import ResultError
from analysis.report.content import ReportError, not_drawn
from analysis.report.page import write_report
from analysis.report.server import address, server
from analysis.report.tables import transfer_tables
from analysis.timings import TimingsFile

CHROMIUM = ("chromium", "chromium-browser", "google-chrome")
# Drawn by the processor: machines that test have no graphics card.
ARGUMENTS = (
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
)
HOSTILE = "<script>alert('claim')</script>"
LOAD_TIMEOUT_MS = 120_000


@pytest.fixture
def hostile(reproduction, tmp_path):
    """Report of the session's results with one figure only, whose caption is an attack."""
    figures = tmp_path / "figures"
    figures.mkdir()
    for ending in (".png", ".pdf"):
        shutil.copy(reproduction / "figures" / f"fig05{ending}", figures)
    write_caption(Caption("fig05", "The boards", HOSTILE, ("Five of them.",)), figures)
    page = write_report(reproduction / "results", tmp_path / "report", figures)
    return page.read_text(encoding="utf-8")


def test_page_shows_figures_tables_and_recordings(reproduction, tiny):
    page = (reproduction / "report" / "index.html").read_text(encoding="utf-8")
    captions = [read_caption(reproduction / "figures", name) for name in ("fig03", "fig08")]
    for caption in captions:
        assert str(escape(caption.title)) in page
        assert str(escape(caption.ours[0])) in page
    for name in ("1a-paper", "4-moves"):
        assert f'href="play/{name}.html"' in page
    for label in ("scenario 1a", "scenario 4", "c = 1.5", "1a-paper/0", "4-moves/0", "dt_s"):
        assert label in page
    assert f"--runs {tiny.runs} --episodes {tiny.train_episodes} --seed 0" in page


def test_captions_are_escaped_and_missing_figures_named(hostile):
    assert HOSTILE not in hostile
    assert str(escape(HOSTILE)) in hostile
    assert "Five of them." in hostile
    for figure in FIGURES:
        assert (f"python -m analysis.figures {figure} " in hostile) == (figure != "fig05")


def test_all_that_the_page_links_to_is_there(reproduction):
    page = (reproduction / "report" / "index.html").read_text(encoding="utf-8")
    links = re.findall(r'(?:href|src)="([^"#][^"]*)"', page)
    files = {link for link in links if not link.startswith("data:")}
    assert len(files) > 20
    for link in files:
        for file in link.split("?url=../"):
            assert (reproduction / "report" / file).is_file()
            assert ":" not in file  # nothing from another machine


def test_episode_can_be_chosen(reproduction, tmp_path):
    results, figures = reproduction / "results", reproduction / "figures"
    page = write_report(results, tmp_path / "report", figures, episode="1a-moves/0")
    assert "recordings/1a-moves-0.rrd" in page.read_text(encoding="utf-8")
    with pytest.raises(
        ReportError, match="--episode 4/7: no such recording; choose one of: 1a-paper/0"
    ):
        write_report(results, tmp_path / "report", figures, episode="4/7")


def test_empty_and_damaged_results(tmp_path):
    with pytest.raises(ReportError, match="nothing: no such folder"):
        write_report(tmp_path / "nothing", tmp_path / "report")
    empty = tmp_path / "results"
    empty.mkdir()
    page = write_report(empty, tmp_path / "report").read_text(encoding="utf-8")
    assert "No episode has been recorded" in page
    assert "No experiment has been run" in page
    results = empty / "experiments" / "fig08" / "results.json"
    results.parent.mkdir(parents=True)
    results.write_text("{")
    with pytest.raises(ResultError, match=r"results\.json: not a result of `python -m agent"):
        write_report(empty, tmp_path / "report")


def test_transfer_is_a_table_with_intervals(row, write_transfer):
    (table,) = transfer_tables(write_transfer(row("4", "moves", 0.85)))
    (cells,) = table.rows
    assert cells[:6] == ("4", "moves", "0.15", "off", "50", "85.0% [75.0, 95.0]")
    assert cells[-1] == "–"
    assert len(cells) == len(table.header)
    assert table.command == "python -m cosim.transfer --seed 0 --scenarios 4 --methods moves"
    few = msgspec.structs.replace(row("2", "moves", 1.0), planned=2)
    (table,) = transfer_tables(write_transfer(few))
    assert table.command.endswith("--scenarios 2 --methods moves --quick")


def test_what_a_reproduction_has_not_drawn_is_made_by_its_command(tmp_path):
    """With its seed and its amount: that of quick ones is a third of the episodes."""
    for name, option in (("quick", " --quick"), ("full", "")):
        timings = TimingsFile(1, {"name": name}, 7, None, {})
        command, _ = not_drawn(tmp_path, tmp_path, timings)["fig09"]
        assert command == f"python -m analysis.reproduce --out . --seed 7{option}"
    alone, *_ = not_drawn(tmp_path, tmp_path, None)["fig09"]
    assert alone.startswith("python -m cosim.run --scenario 1a")


@pytest.fixture
def site(reproduction):
    """Address of the served report."""
    with server(reproduction / "report") as serving:
        thread = threading.Thread(target=serving.serve_forever)
        thread.start()
        yield address(serving)
        serving.shutdown()
        thread.join()


@pytest.fixture
def browser():
    program = next(filter(None, map(shutil.which, CHROMIUM)))
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=list(ARGUMENTS))
        yield browser
        browser.close()


@pytest.mark.browser
def test_viewer_in_the_page_shows_the_episode(site, browser):
    page = browser.new_page(viewport={"width": 800, "height": 450})  # software draws it
    page.set_default_timeout(LOAD_TIMEOUT_MS)
    errors, foreign = [], []
    page.on("console", lambda said: errors.append(said.text) if said.type == "error" else None)
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on("request", lambda asked: None if asked.url.startswith(site) else foreign.append(asked))
    page.goto(site)
    canvas = page.frame_locator("iframe[name=viewer]").locator("canvas")
    canvas.scroll_into_view_if_needed()
    page.frame_locator("iframe[name=viewer]").locator("#state").wait_for(state="hidden")
    # The empty viewer has a few hundred shades of grey; plots and robots have hue.
    coloured = 0.0
    for _ in range(10):
        page.wait_for_timeout(3000)
        picture = Image.open(io.BytesIO(canvas.screenshot())).convert("HSV")
        coloured = float((np.asarray(picture)[:, :, 1] > 100).mean())
        if coloured > 0.01:
            break
    assert coloured > 0.01
    assert errors == []
    assert foreign == []


@pytest.mark.browser
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_page_fits_a_phone(site, browser, scheme):
    page = browser.new_page(viewport={"width": 390, "height": 844}, color_scheme=scheme)
    errors = []
    page.on("console", lambda said: errors.append(said.text) if said.type == "error" else None)
    page.goto(site)
    assert page.evaluate("document.documentElement.scrollWidth") == 390
    # The viewer is not loaded there.
    assert page.evaluate("performance.getEntriesByType('resource').length") <= 1
    text, ground = (
        page.evaluate(f"getComputedStyle(document.body).{name}")
        for name in ("color", "backgroundColor")
    )
    brightness = [sum(map(int, re.findall(r"\d+", colour)[:3])) for colour in (text, ground)]
    assert (brightness[0] < brightness[1]) == (scheme == "light")
    assert abs(brightness[0] - brightness[1]) > 450
    assert errors == []
