"""The report from small results: what it says, and what it refuses."""

import json
import re
import runpy
import shutil
from pathlib import Path

import pytest
from markupsafe import escape

from agent.study.report import Report
from analysis.figures.style import Caption, figure_entries, read_caption, write_caption
from analysis.report.page import not_drawn, transfer_table, write_report
from analysis.timings import TimingsFile
from cosim.base.errors import UserError

ROOT = Path(__file__).parents[3]
HOSTILE = "<script>alert('claim')</script>"


def test_page_shows_figures_tables_and_recordings(reproduction, tiny):
    page = (reproduction / "report" / "index.html").read_text(encoding="utf-8")
    for name in ("fig03", "fig08"):
        caption = read_caption(reproduction / "figures", name)
        assert str(escape(caption.title)) in page
        assert str(escape(caption.ours[0])) in page
    assert "<td>episodes/4-moves/episodes/ep_000.rrd</td>" in page
    assert 'href="play.html"' in page
    played = (reproduction / "report" / "play.html").read_text(encoding="utf-8")
    assert "The policy is by the method moves." in played
    for label in ("scenario 1a", "scenario 4", "c = 1.5", "1a-paper/0", "4-moves/0", "dt_s"):
        assert label in page
    assert f"--runs {tiny.runs} --episodes {tiny.train_episodes} --seed 0" in page
    links = re.findall(r'(?:href|src)="([^"#][^"]*)"', page)
    files = {link for link in links if not link.startswith("data:")}
    assert len(files) > 20
    for file in files:
        assert (reproduction / "report" / file).is_file()
        assert ":" not in file  # nothing from another machine


def test_claims_are_those_of_the_docs_in_their_order(reproduction):
    report, docs = reproduction / "report", ROOT / "docs" / "paper.md"
    rows = json.loads((report / "claims.json").read_text(encoding="utf-8"))
    header = "| the paper | our result | verdict | figure, command |\n"
    table = docs.read_text(encoding="utf-8").partition(header)[2].partition("\n\n")[0]
    papers = [line.split(" | ")[0].removeprefix("| ") for line in table.splitlines()[1:]]
    assert [re.sub("[“”]", '"', row["paper"]) for row in rows] == papers
    claimed = ["fig03", "fig07", "fig08", "fig09", "fig10", "fig11", "fig12", "sequel"]
    assert [row["figure"] for row in rows[1:-2]] == claimed
    page = (report / "index.html").read_text(encoding="utf-8")
    for row in rows:
        assert row["ours"]
        assert row["verdict"]
        cells = "</th><td>".join(str(escape(row[name])) for name in ("paper", "ours"))
        assert row["brief"] == bool(row["figure"])
        said = "brief, tests nothing" if row["brief"] else row["verdict"]
        assert f"{cells}</td><td>{said}</td>" in page
        assert f'id="{row["figure"]}"' in page or row in rows[-2:]
    assert page.count("Brief results, which test no claim.") == len(figure_entries()) + 1


def test_verdicts_of_the_docs_are_kept_from_a_report_that_tests_something(reproduction, tmp_path):
    pages = runpy.run_path(str(ROOT / ".ci" / "pages.py"))
    keep = pages["keep_verdicts"]
    with pytest.raises(SystemExit, match="brief results test no claim"):
        keep(reproduction / "report" / "claims.json")
    rows = json.loads((reproduction / "report" / "claims.json").read_text("utf-8"))
    (tmp_path / "claims.json").write_text(json.dumps([row | {"brief": False} for row in rows]))
    (tmp_path / "docs" / "results").mkdir(parents=True)
    keep.__globals__["ROOT"] = tmp_path
    keep(tmp_path / "claims.json")
    kept, published = (
        json.loads((root / "docs" / "results" / "claims.json").read_text("utf-8"))
        for root in (tmp_path, ROOT)
    )
    assert kept.keys() == published.keys()
    for claim in ("sec-ii-b", "fig-3", "fig-7"):  # of results that small reproductions have whole
        assert kept[claim] == published[claim]


def test_captions_are_escaped_and_missing_figures_named(reproduction, tmp_path):
    """Of the session's results with one figure only, whose caption is an attack."""
    figures = tmp_path / "figures"
    figures.mkdir()
    for ending in (".png", ".pdf"):
        shutil.copy(reproduction / "figures" / f"fig05{ending}", figures)
    write_caption(Caption("fig05", "The boards", HOSTILE, ("Five of them.",)), figures)
    written = write_report(reproduction / "results", figures, tmp_path / "report")
    page = written.read_text(encoding="utf-8")
    assert HOSTILE not in page
    assert str(escape(HOSTILE)) in page
    assert "Five of them." in page
    for figure in figure_entries():
        assert (f"minirobots figures {figure} " in page) == (figure != "fig05")


def test_empty_and_damaged_results(tmp_path):
    with pytest.raises(UserError, match="nothing: no such folder"):
        write_report(tmp_path / "nothing", tmp_path / "figures", tmp_path / "report")
    empty = tmp_path / "results"
    empty.mkdir()
    page = write_report(empty, tmp_path / "figures", tmp_path / "report").read_text(
        encoding="utf-8"
    )
    assert "No experiment has been run" in page
    results = empty / "experiments" / "fig08" / "results.json"
    results.parent.mkdir(parents=True)
    results.write_text("{")
    with pytest.raises(UserError, match=r"results\.json: not a result of `minirobots exp"):
        write_report(empty, tmp_path / "figures", tmp_path / "report")


def test_transfer_is_a_table_with_intervals(row):
    table = transfer_table(Report(seed=0, rows=(row("4", "moves", 0.85),)))
    assert table.command == "minirobots study docs/studies/methods.toml --out results/transfer"
    (cells,) = table.rows
    assert len(cells) == len(table.header)
    assert cells[-1] == "–"
    assert cells[:7] == ("4", "moves", "0.15", "off", "–", "50", "85.0% [75.0, 95.0]")


def test_what_a_reproduction_has_not_drawn_is_made_by_its_command(tmp_path):
    """With its seed and its amount: that of quick ones is a third of the episodes."""
    for name, option in (("quick", " --quick"), ("full", "")):
        timings = TimingsFile(1, {"name": name}, 7, None, {})
        command, _ = not_drawn(tmp_path, tmp_path, timings)["fig09"]
        assert command == f"minirobots reproduce --out . --seed 7{option}"
    alone, *_ = not_drawn(tmp_path, tmp_path, None)["fig09"]
    assert alone.startswith("minirobots run --scenario 1a")
