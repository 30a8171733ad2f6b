"""The page's own controls, by clicks in Chromium."""

import math
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import sync_playwright

from agent import web
from agent.web.page import write_page
from cosim.model.params import TABLE_I, TABLE_II
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_in_world
from cosim.physics.draws import draw_world
from cosim.physics.forces import directions
from cosim.simulation.options import SimulationOptions, resolve
from cosim.simulation.simulate import draw_episode
from tests.agent.web.test_page import compare, played

PROGRAM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
# The first robot is a cell from its target, and the second one drives for long; where the floor
# holds it, it hardly moves, so that no time at which a busy machine looks at it hides its world.
BOARD = Scenario("near", "", ((9, 20), (22, 13)), (((9, 21),), ((27, 4),)), rows=26)
PATCH = """[world]
floor_tilt_deg = 0.2
mu = 0.17
motor_speed_noise = 0.03
mu_patches = [{cells = [20, 0, 29, 12], mu = 0.9}]
"""
# Keeps what the page tells its worker, the texts and discs of the last picture of the board in
# pixels of the canvas, and the cells of maps.
WATCHED = """
window.told = []; window.texts = []; window.discs = []; window.cells = [];
const post = Worker.prototype.postMessage, kind = CanvasRenderingContext2D.prototype;
Worker.prototype.postMessage = function (m) { told.push(m); post.call(this, m); };
for (const [name, kept] of [["fillText", "texts"], ["arc", "discs"]]) {
  const draw = kind[name];
  kind[name] = function (...given) {
    const { a, b, c, d, e, f } = this.getTransform(), [x, y] = name === "arc" ? given : [0, 0];
    const at = [a * x + c * y + e, b * x + d * y + f];
    if (this.canvas.id === "board") window[kept].push([given, ...at]);
    draw.apply(this, given);
  };
}
const fill = kind.fillRect, clear = kind.clearRect;
kind.fillRect = function (...box) {
  if (!this.canvas.id) window.cells.push(box);
  fill.apply(this, box);
};
kind.clearRect = function (...box) {
  if (this.canvas.id === "board") [window.texts, window.discs] = [[], []];
  clear.apply(this, box);
};
"""
# Colours of the words of a plot's caption, and of its lines by the largest value.
PLOTTED = """(() => {
  const [canvas, caption] = ["canvas", "p"].map((kind) => document.createElement(kind)), lines = {};
  document.body.append(canvas, caption);
  const plot = new Plot(canvas, caption, "a", "b", ["ten", "four"]), g = canvas.getContext("2d");
  const [to, stroke] = [g.lineTo, g.stroke];
  let top = Infinity;
  g.lineTo = (x, y) => { top = Math.min(top, y); to.call(g, x, y); };
  g.stroke = () => { lines[top] = g.strokeStyle; top = Infinity; stroke.call(g); };
  plot.add(0, [[0, 0]]);
  plot.add(1, [[10, 4]]);
  plot.draw(0);
  const height = canvas.clientHeight, at = (value) => 6 + ((10 - value) / 10) * (height - 24);
  const near = (value) => lines[Object.keys(lines).findLast((y) => Math.abs(y - at(value)) < 1e-6)];
  const words = [...caption.querySelectorAll("b")].map((word) => word.style.color);
  const hex = (colour) => { g.fillStyle = colour; return g.fillStyle; };
  const found = [words.map(hex), { 10: near(10), 4: near(4) }];
  canvas.remove();
  caption.remove();
  return found;
})()"""
# Lines of a robot's legs, from root to tip, which has moved by what it is bent by.
LEGS = """(() => {
  const feet = [[0.01, 0.005], [-0.01, 0.005], [-0.01, -0.005]].map((at, k) => [`F${k}`, at]);
  const legs = [[1e-3, 0], [2e-3, 0], [3e-3, 0]];
  const machine = { motors: [], feet, legs, enlarged: 10 };
  const board = Object.create(Board.prototype), scenario = { diameter_m: 0.05 }, lines = [];
  const g = document.createElement("canvas").getContext("2d");
  Object.assign(board, { g, scale: 1, scenario, machine });
  board.line = (points) => lines.push(points);
  board.text = () => {};
  const bent = [...Array(9).keys()].map((k) => 1e-4 * k);
  board.drawRobot({ x: 0, y: 0, heading: 0, theta: [], bent }, 0, true);
  return lines.slice(1);
})()"""
# Names of a robot's parts and their places, where it is large and heads to the left.
NAMED = """(() => {
  const motors = [["D", [0.01, 0.02], [0, 0, -1], [1, 0, 0]]];
  const machine = { motors, feet: [["A", [-0.02, 0.01]]], legs: [] };
  const board = Object.create(Board.prototype), scenario = { diameter_m: 0.05 }, texts = {};
  const g = document.createElement("canvas").getContext("2d");
  Object.assign(board, { g, scale: 2001, scenario, machine });
  board.text = (words, x, y) => { texts[words] = [x, y]; };
  board.drawRobot({ x: 0.1, y: 0.2, heading: Math.PI / 2, theta: [0], bent: [] }, 0, true);
  return texts;
})()"""
# How many points a plot keeps, the first and the last time of them.
NEWEST = """(() => {
  const [canvas, caption] = ["canvas", "p"].map((kind) => document.createElement(kind));
  const kept = new Plot(canvas, caption, "a", "b", []);
  for (let k = 0; k <= 400; k++) kept.add(k, [[]]);
  return [kept.points.length, kept.points[0].time, kept.points.at(-1).time];
})()"""
# Numbers along the edges of a board of 20 x 10 cm, and its zone.
DRAWN = """(() => {
  const board = Object.create(Board.prototype), zone = [4, 5, 6, 6];
  const scenario = { cell_m: 0.01, targets: [], walls: [], zone, patches: [] };
  const g = document.createElement("canvas").getContext("2d");
  const texts = [], boxes = [];
  g.strokeRect = (...box) => boxes.push(box);
  Object.assign(board, { g, scale: 600, scenario, size: [0.2, 0.1] });
  board.line = () => {};
  board.text = (words, x, y) => texts.push([words, x, y]);
  board.drawScale();
  board.drawCells();
  return [texts, boxes[0]];
})()"""
OUTCOME = "document.getElementById('outcome').textContent"


@pytest.mark.browser
def test_controls_do_what_they_say(tmp_path):
    (tmp_path / "patch.toml").write_text(PATCH)
    out, worlds = tmp_path / "page.html", [str(tmp_path / "patch.toml")]
    options = SimulationOptions(time_limit=60.0)
    write_page(out, BOARD, options, method="shortest", worlds=worlds, seed=5)
    # The friction of the page is that of the floor between patches.
    (smooth,) = played(out, {"seed": 5, "world": 1, "mu": 0.1})
    setup = resolve(options, BOARD, world=tmp_path / "patch.toml")
    config = replace(setup.config, robot=setup.config.robot._replace(mu=0.1))
    compare(smooth, setup._replace(config=config), "shortest", 5)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=PROGRAM, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1200, "height": 600})
        page.set_default_timeout(120_000)  # on a busy machine
        page.add_init_script(WATCHED)
        page.goto(out.as_uri())
        page.wait_for_function("!document.getElementById('play').disabled && texts.length")
        assert page.inner_text("#outcome") == "ready"
        assert page.inner_text("#error") == ""
        assert page.input_value("#seed") == "5"
        assert "30 × 26 cm" in page.content()
        shown = page.evaluate("shown()")
        scale, (left, bottom) = shown["scale"], shown["origin"]
        page.evaluate("scrollTo(0, 50)")  # pointers have places on the screen
        assert page.evaluate("scrollY") == 50

        def drag(*places_m):
            box = page.locator("#board").bounding_box() or {}
            for number, (x, y) in enumerate(places_m):
                page.mouse.move(box["x"] + left + x * scale, box["y"] + bottom - y * scale, steps=3)
                if number == 0:
                    page.mouse.down()
            page.mouse.up()

        def after(seconds):
            """What is shown after a time, played as fast as it goes."""
            page.click("#play")
            page.wait_for_function(f"shown().time >= {seconds}")
            page.click("#play")
            return page.evaluate("shown()")

        # Targets have the numbers of their robots, and a disc is whole at the edge.
        texts = page.evaluate("texts.map(([[words], x, y]) => [words, x, y])")
        for number, (column, row) in enumerate(BOARD.targets, start=1):
            place = left + 0.01 * (column + 1) * scale, bottom - 0.01 * (row + 1) * scale
            assert any(words == str(number) and math.dist(place, at) < 1.0 for words, *at in texts)
        page.select_option("#speed", "60")
        assert "µ 0.9" not in page.evaluate("texts.map(([[words]]) => words)")
        page.click("#step")
        page.wait_for_function("document.getElementById('play').textContent === 'Play'")
        assert 1.5 < page.evaluate("shown()")["time"] <= 2.0
        own = after(8.0)  # beyond the decision that Step ended with
        # Masses are where the motors' angles put them, seen from above.
        (x, y), heading = own["robots"][1], own["headings"][1]
        turn = np.array(
            [[math.cos(heading), -math.sin(heading)], [math.sin(heading), math.cos(heading)]]
        )
        discs = np.array(page.evaluate("discs.map(([, x, y]) => [x, y])"))
        for mount, theta in zip(TABLE_I.motors, own["theta"][1], strict=True):
            hanging, later = map(np.array, directions(mount.axis))
            mass = math.cos(theta) * hanging + math.sin(theta) * later
            at = turn @ (np.array(mount.place_m[:2]) + 0.65 * 0.2 * 0.025 * mass[:2]) + [x, y]
            pixel = left + at[0] * scale, bottom - at[1] * scale
            assert np.hypot(*(discs - pixel).T).min() < 0.3
        # The path is that of the chosen robot.
        for robot, (_, start) in enumerate(zip(BOARD.targets, BOARD.starts, strict=True)):
            page.keyboard.press(str(robot + 1))
            page.wait_for_function(f"document.getElementById('of').textContent == {robot + 1}")
            away_m = math.dist(own["robots"][robot], 0.01 * (np.array(start[0]) + 0.5))
            path_cm = float(page.inner_text("#path").removesuffix(" cm"))
            assert 100.0 * away_m - 0.1 <= path_cm < 100.0 * away_m + 0.9
        page.keyboard.press("1")
        # A robot that arrived and is put elsewhere drives again.
        assert math.dist(own["robots"][0], (0.095, 0.205)) < 0.006
        drag(own["robots"][0], (0.05, 0.1))
        page.wait_for_function(f"{OUTCOME} === 'running, changed by hand'")
        again = after(own["time"] + 8.0)
        assert math.dist(again["robots"][0], (0.05, 0.1)) > 0.01
        # On its own target it has arrived, and stays there.
        drag(again["robots"][0], (0.095, 0.205))
        page.wait_for_timeout(200)
        again = after(again["time"] + 8.0)
        assert math.dist(again["robots"][0], (0.095, 0.205)) < 0.006
        # Arrows move the chosen robot by a cell.
        for key, (dx, dy) in {"Up": (0, 1), "Right": (1, 0), "Down": (0, -1)}.items():
            x, y = page.evaluate("shown()")["robots"][0]
            page.focus("#board")
            page.keyboard.press(f"Arrow{key}")
            there = (
                f"{x + 0.01 * dx} - shown().robots[0][0], {y + 0.01 * dy} - shown().robots[0][1]"
            )
            page.wait_for_function(f"Math.hypot({there}) < 1e-6")
        again = page.evaluate("shown()")
        # Maps of both robots have their columns along x.
        drawn = {(x, y) for x, y, *_ in page.evaluate("cells")}
        assert drawn == {(x, y) for x in range(30) for y in range(26)}
        # There is no room for a robot on another one, nor beyond the board, which is not square.
        drag(again["robots"][0], (0.1, 0.272))
        page.wait_for_function("!document.getElementById('error').hidden")
        assert "no room for robot 1" in page.inner_text("#error")
        drag(*again["robots"])
        page.wait_for_timeout(200)
        assert math.dist(page.evaluate("shown()")["robots"][0], again["robots"][0]) < 1e-3
        # Robots drive in the world that is chosen, and with the shield if that is.
        page.select_option("#world", "1")
        page.wait_for_function(f"{OUTCOME} === 'ready'")
        assert "µ 0.9" in page.evaluate("texts.map(([[words]]) => words)")
        assert [page.input_value(f"#{name}") for name in ("mu", "noise")] == ["0.17", "0.03"]
        _, world = find_in_world(BOARD, tmp_path / "patch.toml")
        _, seed = draw_episode(BOARD, 5, 0)
        drawn = draw_world(world, (TABLE_II, TABLE_II), 2, seed).tilt_direction_deg
        downhill = page.evaluate("shown()")["downhill"]
        assert math.cos(downhill - math.radians(drawn)) == pytest.approx(1.0, abs=1e-9)
        other = after(8.0)
        moved = (math.dist(of["robots"][1], (0.275, 0.045)) for of in (own, other))
        assert next(moved) > 0.01 > 2.0 * next(moved)
        assert max(other["trails"]) > 1
        page.click("#restart")
        page.wait_for_function(f"{OUTCOME} === 'ready'")
        assert page.evaluate("shown()")["trails"] == [1, 1]
        page.evaluate("document.getElementById('with-shield').hidden = false")  # here it has none
        page.uncheck("#shielded")
        page.check("#shielded")
        page.select_option("#world", "0")
        begun = page.evaluate("told.filter((m) => m.action === 'begin')")
        asked = [(each["world"], each["options"]["shielded"]) for each in begun]
        assert asked == [(0, True), (1, True), (1, True), (1, False), (1, True), (0, True)]
        browser.close()


@pytest.mark.browser
def test_curves_have_the_colours_of_their_names_and_legs_their_own_bend():
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=PROGRAM, args=["--no-sandbox"])
        page = browser.new_page()
        for script in ("board.js", "plot.js"):
            page.add_script_tag(path=Path(web.__file__).with_name("page") / script)
        words, lines = page.evaluate(PLOTTED)
        assert [lines["10"], lines["4"]] == words
        assert page.evaluate(NEWEST) == [400, 1.0, 400.0]
        marks, zone = page.evaluate(DRAWN)
        assert marks == [
            ["0", 0, 0],
            ["10", 0.1, 0],
            ["20", 0.2, 0],
            ["10", 0, 0.1],
            ["cm", 0.2, 0],
        ]
        assert zone == pytest.approx([0.04, 0.05, 0.03, 0.02])
        assert len({*words}) == 2
        named = page.evaluate(NAMED)
        assert named.keys() == {"1", "D", "A"}
        assert named["D"] == pytest.approx([0.1 - 0.68 * 0.02, 0.2 + 0.68 * 0.01])
        assert named["A"] == pytest.approx([0.1 - 0.68 * 0.01, 0.2 - 0.68 * 0.02])
        feet = (0.01, 0.005), (-0.01, 0.005), (-0.01, -0.005)
        for k, ((root, tip), (x, y)) in enumerate(zip(page.evaluate(LEGS), feet, strict=True)):
            assert root == pytest.approx([x + 1e-3 * (k + 1), y])
            assert tip == pytest.approx([x + 3e-3 * k, y + 3e-3 * k + 1e-3])
        browser.close()
