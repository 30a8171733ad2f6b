"""The page in Node.js and in a browser: its bits, and what people see and do."""

import json
import math
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from playwright.sync_api import sync_playwright

import agent
from agent.training.policy import load_policy
from agent.web.page import write_page
from cosim.coupling.rl_step import decide
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import ROUGH
from cosim.simulation.batch import Batch
from cosim.simulation.options import Setup, SimulationOptions, resolve
from cosim.simulation.simulate import draw_episode
from tests.alone import python

pytestmark = pytest.mark.browser
PLAY = Path(__file__).with_name("play.js")
CHROMIUM = ("chromium", "chromium-browser", "google-chrome")
LOADED = "!document.getElementById('play').disabled || window.pageError"
TIME = "document.getElementById('time').textContent"
HOSTILE = "</script><script>window.hacked = true</script>{data}"
SLOPE = """[world]
floor_tilt_deg = 1.0
edge = true
restitution = 0.2
motor_spread = 0.05
mu_patches = [{cells = [10, 8, 20, 13], mu = 0.3}]
"""


INNER = Scenario(
    "inner", "", ((8, 15), (22, 15)), (((8, 8), (8, 22)), ((22, 8), (22, 22)))
)  # away from the edge


class Case(NamedTuple):
    """What is played, in a time that shows something of it."""

    scenario: str | Scenario
    method: str
    options: dict[str, Any]
    seeds: tuple[int, ...] = (1,)


CASES = {
    "pair": Case("4", "shortest", {}),
    "rough": Case("4", "moves", {"shield": True, "world": ROUGH}, (0, 1, 2)),
    "slope": Case(INNER, "shortest", {"world": SLOPE, "time_limit": 100.0}, (0, 1)),
    "group": Case("4-cross", "planned", {"through": True, "shield": True}),
    "droplet": Case("2", "shortest", {"preset": "droplet", "time_limit": 60.0}),
    "reaction": Case("2", "shortest", {"reaction": True, "time_limit": 60.0}),
    "fastest": Case("4", "fastest", {"through": True}),
    "one": Case("1a", "moves", {}),
    "paper": Case("2", "paper", {}),
}


@pytest.fixture(scope="module")
def chromium():
    program = next(filter(None, map(shutil.which, CHROMIUM)))
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture
def browser(chromium):
    yield chromium
    for context in chromium.contexts:  # an open page draws as long as it is there
        context.close()


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Write the page of a case, once; return it and the options of its episodes."""
    pages = {}

    def write(name: str) -> tuple[Path, SimulationOptions]:
        if name not in pages:
            case, folder = CASES[name], tmp_path_factory.mktemp(name)
            given = dict(case.options)
            if isinstance(given.get("world"), str):
                (folder / "world.toml").write_text(given["world"])
                given["world"] = folder / "world.toml"
            options = SimulationOptions(**given)
            size = write_page(folder / "page.html", case.scenario, options, method=case.method)
            assert size == (folder / "page.html").stat().st_size < 3e6
            pages[name] = folder / "page.html", options
        return pages[name]

    return write


def setup_of(name: str, options: SimulationOptions) -> Setup:
    return resolve(options, CASES[name].scenario)


def played(page: Path, *asked: dict[str, Any]) -> list[dict[str, Any]]:
    """Episodes of a page in Node.js."""
    command = ["node", str(PLAY), str(page), *map(json.dumps, asked)]
    run = subprocess.run(command, capture_output=True, text=True, check=True)
    return [json.loads(line) for line in run.stdout.splitlines()]


def compare(found: dict[str, Any], setup: Setup, method: str, seed: int) -> None:
    """Compare an episode of a page with the co-simulation's, bit by bit: JSON keeps every bit."""
    scenario, config, fmu = setup
    policy = agent.train(scenario, method=method, preset=config.preset)
    batch, positions = Batch(fmu, config, scenario.robots, 1), []
    episode = batch.begin(0, scenario, *draw_episode(scenario, seed, 0))
    while not episode.outcome:
        step = batch.advance({0: decide(policy, episode.observation).action})[0]
        positions.append(step.samples.position[-1].tolist())
    batch.close()
    assert found["positions"] == positions
    assert found["time"] == episode.time_s
    assert found["outcome"] == str(episode.outcome).replace("_", " ")
    # the page adds up in another order
    assert found["paths"] == pytest.approx(episode.measures.path_length_m, rel=1e-4)


def opened(browser, path, **options):
    """The page in the browser, and what it complains of or asks the network for."""
    page = browser.new_page(**options)
    page.set_default_timeout(300_000)  # on a busy machine
    said = []
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("request", lambda asked: said.append(asked.url) if "http" in asked.url[:4] else None)
    page.goto(path.absolute().as_uri())
    page.wait_for_function(LOADED)
    return page, said


BRIEF = ("pair",)  # the kernels of most other tests


@pytest.mark.parametrize(
    "name",
    [*BRIEF, *(pytest.param(n, marks=pytest.mark.slow) for n in CASES if n not in BRIEF)],
)
def test_episodes_have_the_bits_of_the_co_simulation(browser, written, name):
    path, options = written(name)
    case, setup = CASES[name], setup_of(name, options)
    seeds = case.seeds
    for seed, found in zip(seeds, played(path, *({"seed": s} for s in seeds)), strict=True):
        compare(found, setup, case.method, seed)
    page, said = opened(browser, path)
    recorded = page.evaluate(f"recordEpisode({{seed: {seeds[0]}}})")
    outcome = page.evaluate("JSON.parse(document.getElementById('data').textContent).outcomes")
    compare(recorded | {"outcome": outcome[recorded["outcome"]]}, setup, case.method, seeds[0])
    assert said == []


@pytest.mark.slow
def test_every_world_of_a_page_has_its_own_episodes(tmp_path):
    options = SimulationOptions(shield=True, time_limit=60.0)
    write_page(tmp_path / "page.html", "4", options, method="shortest", worlds=["rough"])
    own, rough, alone = played(
        tmp_path / "page.html", {"world": 0}, {"world": 1}, {"world": 0, "shielded": False}
    )
    compare(own, resolve(options, "4"), "shortest", 0)
    compare(rough, resolve(options, "4", world=ROUGH), "shortest", 0)
    assert alone["positions"] != own["positions"]


@pytest.mark.slow
def test_memory_does_not_grow_in_ten_minutes(written):
    path, _ = written("pair")
    runs = played(path, *({"seed": seed} for seed in range(10)))
    assert sum(run["time"] for run in runs) > 600.0
    assert len({run["memory"] for run in runs}) == 1


@pytest.mark.long
def test_friction_and_noise_change_an_episode_as_in_the_co_simulation(written):
    path, options = written("pair")
    slippery, quiet = played(path, {"seed": 1, "mu": 0.1}, {"seed": 1, "noise": 0.0})
    setup = setup_of("pair", options)  # set points stay those of the page
    config = setup.config
    other = replace(config, robot=config.robot._replace(mu=0.1))
    compare(slippery, setup._replace(config=other), "shortest", 1)
    other = replace(config, noise=config.noise._replace(relative_amplitude=0.0))
    compare(quiet, setup._replace(config=other), "shortest", 1)


def test_an_episode_goes_on_after_a_place_without_room(written):
    away = {"robot": 0, "x": -1.0, "y": 0.1, "time": 0.7}
    usual, refused = played(written("pair")[0], {"seed": 1}, {"seed": 1, "refused": away})
    assert refused["positions"] == usual["positions"][1:]
    assert [refused[of] for of in ("time", "paths")] == [usual[of] for of in ("time", "paths")]


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_page_is_played_by_keys_on_a_phone(browser, written, scheme):
    size = {"width": 390, "height": 844}
    page, said = opened(browser, written("pair")[0], viewport=size, color_scheme=scheme)
    assert not page.is_visible("#explained p")
    page.keyboard.press(".")
    page.wait_for_function(f"{TIME} === '2.0 s'")
    page.keyboard.press("+")
    assert page.input_value("#speed") == "30"
    page.keyboard.press(" ")
    page.wait_for_function(f"parseFloat({TIME}) > 3")
    assert page.inner_text("#play") == "Pause"
    assert not page.is_visible("#world")  # there is one, without a shield
    assert not page.is_visible("#shielded")
    page.keyboard.press(" ")
    assert page.inner_text("#play") == "Play"
    page.keyboard.press("2")
    assert page.input_value("#robot") == "1"
    page.keyboard.press("r")
    page.wait_for_function(f"{TIME} === '0.0 s'")
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


def test_page_explains_itself_on_the_first_visit_and_to_screen_readers(browser, written):
    page, said = opened(browser, written("pair")[0])
    assert "2 robots of 5 cm drive across a board of 30 × 30 cm" in page.inner_text("header p")
    assert page.is_visible("#explained p")  # on a phone it is folded: plots are near the board
    page.reload()
    page.wait_for_function(LOADED)
    assert not page.is_visible("#explained p")
    named = "[...document.querySelectorAll('input, select, button, canvas')].filter("
    named += "(e) => !e.labels?.length && !e.textContent.trim() && !e.getAttribute('aria-label'))"
    page.wait_for_function(f"{named}.length === 0")
    assert re.match(
        r"Board from above\. robot 1 at \d+, \d+ cm", page.get_attribute("#board", "aria-label")
    )
    assert said == []


# Pauses the page as soon as the worker is ahead of what is shown, at the end of the episode or not.
PAUSED = """new Promise((done) => {
  const look = () => {
    const { ahead, ends } = shown();
    if (ahead < 1 || (%s && !ends)) return requestAnimationFrame(look);
    document.getElementById("play").click();
    requestAnimationFrame(() => done(shown()));
  };
  document.getElementById("play").click();
  look();
})"""
BY_HAND = "document.getElementById('outcome').textContent === 'running, changed by hand'"


@pytest.mark.long
def test_changes_act_on_the_moment_that_is_shown(browser, written):
    page, said = opened(browser, written("pair")[0])
    page.focus("#board")
    for last, speed in (("false", "10"), ("true", "60")):  # the worker has computed the end then
        page.keyboard.press("r")
        page.wait_for_function("document.getElementById('outcome').textContent === 'ready'")
        page.select_option("#speed", speed)
        before = page.evaluate(PAUSED % last)
        assert before["ahead"] > 0.5
        path_cm = page.inner_text("#path")
        page.keyboard.press("ArrowUp")
        page.keyboard.press("ArrowLeft")
        page.wait_for_function(BY_HAND)
        page.wait_for_timeout(200)
        after = page.evaluate("shown()")
        assert 0.0 <= before["time"] - after["time"] < 0.0011  # a control period
        assert after["ahead"] == 0.0
        moved, other = map(math.dist, before["robots"], after["robots"])
        assert 0.009 < moved < 0.015  # one cell up or to the left, or both
        assert other < 2e-4  # vibrations between two pictures
        page.wait_for_timeout(200)
        assert page.inner_text("#path") == path_cm  # what was computed ahead is not driven
        page.keyboard.press(".")
        page.wait_for_function(f"shown().time > {after['time'] + 1.0}")
    assert said == []


@pytest.mark.long
def test_an_episode_that_has_ended_says_so_to_who_moves_robots(browser, written):
    page, said = opened(browser, written("pair")[0])
    page.select_option("#speed", "60")
    page.focus("#board")
    page.keyboard.press("ArrowDown")
    page.wait_for_function("document.getElementById('outcome').textContent.endsWith('by hand')")
    page.keyboard.press("Space")
    page.wait_for_function("shown().ends && shown().ahead === 0")
    assert page.inner_text("#outcome") == "success, changed by hand"
    page.keyboard.press("ArrowUp")
    assert "has ended; restart it" in page.inner_text("#error")
    page.keyboard.press("r")
    page.wait_for_function("document.getElementById('error').hidden")
    assert said == []


@pytest.mark.slow
def test_pages_are_equal_wherever_they_are_written(written, tmp_path):
    path, _ = written("pair")
    script = (
        "import sys; from pathlib import Path; from agent.web.page import write_page;"
        "write_page(Path(sys.argv[1]), '4', method='shortest')"
    )
    pages = [path.read_bytes()]
    for name in ("a.html", "b.html"):  # processes of their own, with addresses of their own
        python("-c", script, tmp_path / name, check=True)
        pages.append((tmp_path / name).read_bytes())
    assert pages[1] == pages[2] == pages[0]


def test_damaged_page_shows_its_error_as_text(browser, written, tmp_path):
    text = written("pair")[0].read_text("utf-8")
    start = text.index('"wasm":"') + 40
    path = tmp_path / "page.html"
    path.write_text(text[:start] + "AAAA" + text[start + 4 :], "utf-8")
    page, _ = opened(browser, path)
    assert page.inner_text("#error") != ""
    assert page.inner_text("#outcome") == "error"


@pytest.mark.slow  # one robot has kernels of its own
def test_titles_cannot_run_scripts(browser, tmp_path):
    scenario = Scenario("hostile", HOSTILE, ((5, 5),), (((5, 9),),))
    write_page(tmp_path / "page.html", scenario, method="shortest")
    page, said = opened(browser, tmp_path / "page.html")
    assert page.inner_text("h1") == f"Scenario hostile: {HOSTILE}"
    assert page.evaluate("window.hacked") is None
    assert said == []


@pytest.mark.long
def test_command_writes_a_page_or_refuses(command, tmp_path):
    policy, out = tmp_path / "policy.npz", tmp_path / "page.html"
    agent.train("4", method="shortest").save(policy)
    made = command("web", policy, "--scenario", "4", "--out", out, "--json")
    assert json.loads(made.stdout.splitlines()[-1])["bytes"] == out.stat().st_size < 3e6
    assert load_policy(policy).digest()
    for arguments, named in (
        ([policy, "--scenario", "2"], "scenario 4"),
        (["--scenario", "swarm-64"], "at most 16"),
        (["--open-loop", "motors"], "--open-loop"),
        (["--worlds", "rogh"], "rogh"),
        (["--worlds", "rough", "rough"], "two have one name"),
        (["--worlds", "own.toml"], "two have one name, or one is called own"),
        (["--motor-fmu", __file__], "--motor-fmu"),
        ([policy, "--method", "shortest"], "--method"),
        ([__file__], "policy"),
        (["--seed", str(2**53)], "2^53"),
        (["--out", "page.txt"], ".html"),
    ):
        refused = command("web", *arguments)
        assert refused.returncode, arguments
        assert named in refused.stderr, arguments
        assert "Traceback" not in refused.stderr
