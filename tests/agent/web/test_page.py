"""The page in a browser, opened from disk: its bits, and what people see and do."""

import json
import math
import shutil
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from playwright.sync_api import sync_playwright

import agent
from agent.web.build import cached_wasm
from agent.web.page import write_page
from cosim.model.outcome import BY_RANK, Outcome
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import ROUGH, find_scenario
from cosim.simulation.options import SimulationOptions, resolve
from tests.agent.deep.test_deep import network
from tests.agent.firmware.test_firmware import random_policy
from tests.references.web_episode import steps_of

CHROMIUM = ("chromium", "chromium-browser", "google-chrome")
PATCH = {"cells": (10, 8, 20, 13), "mu": 0.3}
LOADED = "!document.getElementById('play').disabled || window.pageError"
HOSTILE = "</script><script>window.hacked = true</script>{data}"


@pytest.fixture(scope="module")
def browser():
    program = next(filter(None, map(shutil.which, CHROMIUM)))
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"])
        yield browser
        browser.close()


def written(path, policy, scenario=None, world=None, **options):
    """Write a page of a policy, and return the setup of its episodes."""
    scenario = scenario or policy.config.scenario
    setup = resolve(SimulationOptions(portable=True, **options), scenario, world=world)
    write_page(path, policy, setup.scenario, setup.config, cached_wasm())
    return setup


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


def compare(page, policy, setup, seed) -> str:
    """Compare an episode of a page with that of `cosim.simulate`; how it ended."""
    recorded = page.evaluate(f"recordEpisode({{seed: {seed}}})", None)
    positions, ended = [], (Outcome.RUNNING, 0.0)
    for simulation, step in steps_of(policy, setup, seed):
        positions.append(step.samples.position[-1].ravel().tolist())
        ended = simulation.outcome, simulation.time_s
    assert recorded["positions"] == positions  # JSON keeps every bit
    assert (BY_RANK[recorded["outcome"]], recorded["time_s"]) == ended
    return str(ended[0])


@pytest.mark.browser
def test_page_has_the_bits_of_the_co_simulation_and_reports_success(browser, tmp_path):
    policy = agent.train("1a", method="shortest")
    setup = written(tmp_path / "page.html", policy)
    page, said = opened(browser, tmp_path / "page.html")
    assert compare(page, policy, setup, 1) == "success"
    assert page.inner_text("#outcome") == "success"
    assert said == []


@pytest.mark.browser
@pytest.mark.slow
@pytest.mark.parametrize("name", ["1b", "2", "3", "4", "5-doorway"])
def test_more_pages_have_the_bits_of_the_co_simulation(browser, tmp_path, name):
    policy = agent.train(name)
    setup = written(tmp_path / "page.html", policy)
    assert (tmp_path / "page.html").stat().st_size < 3e6
    page, said = opened(browser, tmp_path / "page.html")
    outcomes = [compare(page, policy, setup, seed) for seed in range(5)]
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
    assert not page.is_visible("#world")  # there is one, without a shield
    assert not page.is_visible("#shielded")
    page.keyboard.press(" ")
    page.wait_for_timeout(300)
    assert page.inner_text("#play") == "Play"
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


@pytest.mark.slow
@pytest.mark.browser
def test_robots_are_dragged_to_where_there_is_room(browser, tmp_path):
    policy = random_policy(find_scenario("2"), "xy", np.random.default_rng(0))
    written(tmp_path / "page.html", policy, world={"mu_patches": [PATCH]}, shield=True)
    page, said = opened(browser, tmp_path / "page.html", viewport={"width": 1200, "height": 900})
    page.wait_for_function("shown().scale")
    shown, box = page.evaluate("shown()"), page.locator("#board").bounding_box()
    before, scale, rows_m = shown["robots"], shown["scale"], shown["rows_m"]

    def pixel(x, y):
        return box["x"] + x * scale, box["y"] + (rows_m - y) * scale

    page.mouse.move(*pixel(*before[0]))
    page.mouse.down()
    page.mouse.move(*pixel(0.15, 0.15), steps=2)
    page.mouse.move(*pixel(*before[1]))  # where the other robot is
    page.mouse.up()
    page.wait_for_function("document.getElementById('outcome').textContent.includes('by hand')")
    after = page.evaluate("shown().robots")
    assert after[0] != before[0]
    assert math.dist(after[0], after[1]) > 0.06
    assert after[1] == before[1]
    page.focus("#board")
    page.keyboard.press("ArrowUp")
    page.wait_for_function(f"Math.abs(shown().robots[0][1] - {after[0][1] + 0.01}) < 1e-9")
    page.keyboard.press("r")
    page.wait_for_function("document.getElementById('outcome').textContent === 'running'")
    assert page.evaluate("shown().robots") == before
    page.uncheck("#shielded")
    assert said == []


@pytest.mark.browser
def test_a_click_sets_a_target_of_a_network(browser, tmp_path):
    policy = network(find_scenario("2"))
    policy = replace(policy, config=msgspec.structs.replace(policy.config, any_target=True))
    setup = written(tmp_path / "page.html", policy, time_limit=8.0)
    page, said = opened(browser, tmp_path / "page.html", viewport={"width": 1200, "height": 900})
    box = page.locator("#board").bounding_box()
    page.select_option("#robot", label="r2")
    page.mouse.click(box["x"] + 0.85 * box["width"], box["y"] + 0.55 * box["height"])
    page.wait_for_function("shown().targets[1].join() === '25,13'")
    page.focus("#board")
    page.keyboard.press("Shift+ArrowRight")
    page.wait_for_function("shown().targets[1].join() === '26,13'")
    moved = policy.in_scenario(
        replace(policy.config.scenario, targets=(policy.config.scenario.targets[0], (26, 13)))
    )
    expected = moved.maps()[1].action.ravel()
    known = moved.maps()[1].visits.ravel() > 0
    assert np.array_equal(np.array(page.evaluate("shown().map"))[known], expected[known])
    page.mouse.click(box["x"] + 0.5 * box["width"], box["y"] + 0.4 * box["height"])  # r1's
    page.keyboard.press(".")
    page.wait_for_function("document.getElementById('time').textContent === '2.0 s'")
    assert page.evaluate("shown().targets")[1] == [26, 13]
    compare(page, moved, setup._replace(scenario=moved.config.scenario), 1)
    assert said == []


@pytest.mark.browser
@pytest.mark.slow
def test_a_rough_world_with_a_shield_has_the_bits_of_the_co_simulation(browser, tmp_path):
    policy, path = agent.train("4", method="shortest"), tmp_path / "page.html"
    options = SimulationOptions(portable=True, shield=True, time_limit=120.0)
    ideal, rough = resolve(options, "4"), resolve(options, "4", world=ROUGH)
    worlds = {"rough": rough.config}
    write_page(path, policy, ideal.scenario, ideal.config, cached_wasm(), worlds=worlds)
    page, said = opened(browser, path)
    for name, setup, seeds in (("rough", rough, range(5)), ("own", ideal, [0])):
        page.select_option("#world", label=name)
        page.wait_for_function(f"shown().world === '{name}'")
        for seed in seeds:
            compare(page, policy, setup, seed)
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
        (["--scenario", "1a", "--reaction"], "--reaction"),
        (["--scenario", "1a", "--worlds", "rogh"], "rogh"),
        (["--scenario", "1a", "--worlds", "rough", "rough"], "two have one name"),
        (["--scenario", "1a", "--worlds", "own.toml"], "two have one name, or one is called own"),
        (["--scenario", "1a", "--motor-fmu", __file__], "--motor-fmu"),
        (["--scenario", "1a", "--motor-parameter", "J=5e-9"], "--motor-parameter"),
        (["--scenario", "1a", "--policy", __file__], "policy"),
        (["--scenario", "1a", "--out", "page.txt"], ".html"),
    ):
        refused = command(*asked, *arguments)
        assert refused.returncode
        assert named in refused.stderr
        assert "Traceback" not in refused.stderr
