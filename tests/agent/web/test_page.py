"""The page in a browser, opened from disk: the bits of its C, and what people see and do."""

import json
import shutil

import pytest
from playwright.sync_api import sync_playwright

import agent
from agent.web.build import cached_wasm, compile_native
from agent.web.packing import pack
from agent.web.page import write_page
from cosim.model.scenario import Scenario
from cosim.simulation.options import SimulationOptions, resolve
from tests.references.web_episode import NativeEpisode

CHROMIUM = ("chromium", "chromium-browser", "google-chrome")
LOADED = "!document.getElementById('play').disabled || window.pageError"
HOSTILE = "</script><script>window.hacked = true</script>{data}"


@pytest.fixture(scope="module")
def browser():
    program = next(filter(None, map(shutil.which, CHROMIUM)))
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    out = tmp_path_factory.mktemp("web") / "own.so"
    compile_native(out)
    return out


def written(path, policy, scenario=None, **options):
    """A page of a policy, and the same episode in this process."""
    scenario = scenario or policy.config.scenario
    scenario, config, _ = resolve(SimulationOptions(**options), scenario)
    write_page(path, policy, scenario, config, cached_wasm())
    return pack(policy, scenario, config), config, scenario


def opened(browser, path, **options):
    """The page in the browser, and what it complains of or asks the network for."""
    page = browser.new_page(**options)
    said = []
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("request", lambda asked: said.append(asked.url) if "http" in asked.url[:4] else None)
    page.goto(path.absolute().as_uri())
    page.wait_for_function(LOADED)
    return page, said


def compare(page, library, packed, config, scenario, seed) -> str:
    """Compare an episode of a page with that of the library; how it ended."""
    recorded = page.evaluate(f"recordEpisode({{seed: {seed}}})", None)
    episode, positions = NativeEpisode(library, packed), []
    outcome = episode.begin(seed)
    while not outcome:
        outcome = episode.advance(config.periods_per_step)
        positions.append(episode.view()["position"][: 3 * scenario.robots].tolist())
    assert recorded["positions"] == positions  # JSON keeps every bit
    assert recorded["time_s"] == episode.view()["time_s"][0]
    return str(outcome)


@pytest.mark.browser
def test_page_has_the_bits_of_its_c_and_reports_success(browser, library, tmp_path):
    policy = agent.train("1a", method="shortest")
    packed, config, scenario = written(tmp_path / "page.html", policy)
    page, said = opened(browser, tmp_path / "page.html")
    assert compare(page, library, packed, config, scenario, 1) == "success"
    assert page.inner_text("#outcome") == "success"
    assert said == []


@pytest.mark.browser
@pytest.mark.slow
@pytest.mark.parametrize("name", ["2", "3", "4", "5-doorway"])
def test_more_pages_have_the_bits_of_their_c(browser, library, tmp_path, name):
    packed, config, scenario = written(tmp_path / "page.html", agent.train(name))
    assert (tmp_path / "page.html").stat().st_size < 3e6
    page, said = opened(browser, tmp_path / "page.html")
    outcomes = [compare(page, library, packed, config, scenario, seed) for seed in range(5)]
    assert outcomes.count("success") >= 4
    assert said == []


@pytest.mark.browser
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_page_is_played_by_keys_on_a_phone(browser, tmp_path, scheme):
    written(tmp_path / "page.html", agent.train("1a", method="shortest"))
    size = {"width": 390, "height": 844}
    page, said = opened(browser, tmp_path / "page.html", viewport=size, color_scheme=scheme)
    page.keyboard.press(".")
    page.wait_for_function("document.getElementById('time').textContent === '2.0 s'")
    page.keyboard.press("+")
    assert page.input_value("#speed") == "30"
    page.keyboard.press(" ")
    page.wait_for_function("parseFloat(document.getElementById('time').textContent) > 3")
    assert page.inner_text("#play") == "Pause"
    page.keyboard.press("r")
    page.wait_for_function("document.getElementById('time').textContent === '0.0 s'")
    assert page.inner_text("#play") == "Play"
    assert page.evaluate("document.documentElement.scrollWidth") == size["width"]
    page.fill("#mu", "9")
    page.keyboard.press("Enter")
    page.wait_for_function("!document.getElementById('error').hidden")
    assert "friction = 9 is invalid; give a number from 0 to 2" in page.inner_text("#error")
    page.fill("#mu", "0.2")
    page.keyboard.press("Enter")
    page.wait_for_function("document.getElementById('error').hidden")
    assert said == []


@pytest.mark.browser
def test_damaged_page_shows_its_error_as_text(browser, tmp_path):
    path = tmp_path / "page.html"
    written(path, agent.train("1a", method="shortest"))
    text = path.read_text("utf-8")
    start = text.index('"wasm":"') + 40
    path.write_text(text[:start] + "AAAA" + text[start + 4 :], "utf-8")
    page, _ = opened(browser, path)
    assert page.inner_text("#error") != ""
    assert page.inner_text("#outcome") == "error"


@pytest.mark.browser
def test_titles_cannot_run_scripts(browser, tmp_path):
    scenario = Scenario("hostile", HOSTILE, ((5, 5),), (((5, 9),),))
    policy = agent.train(scenario, method="shortest")
    written(tmp_path / "page.html", policy)
    page, said = opened(browser, tmp_path / "page.html")
    assert page.inner_text("header p") == HOSTILE
    assert page.evaluate("window.hacked") is None
    assert said == []


@pytest.mark.long
def test_command_writes_a_page_or_refuses(command, tmp_path):
    policy, out = tmp_path / "policy.npz", tmp_path / "page.html"
    agent.train("1a", method="shortest").save(policy)
    asked = ["web", "--policy", str(policy), "--out", str(out), "--json"]
    made = command(*asked, "--scenario", "1a")
    assert json.loads(made.stdout.splitlines()[-1])["bytes"] == out.stat().st_size < 3e6
    for arguments, named in (
        (["--scenario", "2"], "scenario 1a"),
        (["--scenario", "1a", "--shield"], "--shield"),
        (["--scenario", "1a", "--motor-fmu", __file__], "--motor-fmu"),
        (["--scenario", "1a", "--motor-parameter", "J=5e-9"], "--motor-parameter"),
        (["--scenario", "1a", "--policy", __file__], "policy"),
        (["--scenario", "1a", "--out", "page.txt"], ".html"),
    ):
        refused = command(*asked, *arguments)
        assert refused.returncode
        assert named in refused.stderr
        assert "Traceback" not in refused.stderr
