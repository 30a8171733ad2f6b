// The page: controls, readout, plots, and what a worker computes ahead of what is shown.
const $ = (id) => document.getElementById(id);
const SPEEDS = [1, 5, 10, 30, 60];
// frames: those that are known, from the one that is shown on; clock: the simulated time that is shown
let board, frames = [], clock = 0, wall = performance.now(), number = 0, selected = 0, downhill = null;
let playing = false, single = false, asked = false, moved = false, dragged = null, waiting;
let rate = Infinity, pace = { wall: 0, time: 0 };

function say(text) {
  $("error").textContent = text;
  $("error").hidden = !text;
}

// What the page cannot recover from.
function fail(text) {
  say(text);
  $("outcome").textContent = "error";
  playing = false;
  window.pageError = text;
}
addEventListener("error", (event) => fail(event.message));
addEventListener("unhandledrejection", (event) => fail(String(event.reason?.message ?? event.reason)));

const data = JSON.parse($("data").textContent);
const { machine, scenario } = data, [motors, feet] = [machine.motors, machine.feet].map((parts) => parts.map(([name]) => name));
const plots = [
  ["omega", "Motor speeds ω", "rad/s", motors],
  ["voltage", "Motor voltages", "V", motors],
  ["force", "Contact forces of the feet, mean of 1 ms", "N", feet],
].map(([name, ...shown]) => [name, new Plot($(name), $(`${name}-title`), ...shown)]);
const worker = new Worker(URL.createObjectURL(new Blob([$("worker").textContent], { type: "text/javascript" })));
worker.onerror = (event) => fail(`the computation stopped: ${event.message}`);
worker.onmessage = ({ data: message }) => {
  if (message.kind === "error") fail(message.text);
  else if (message.number === number) take[message.kind](message); // else of an episode that was given up
};

const take = {
  begun(message) {
    plots.forEach(([, plot]) => plot.clear());
    [asked, moved, downhill] = [false, false, message.downhill];
    for (const id of ["play", "restart"]) $(id).disabled = false;
    jump(message.frames);
  },
  placed(message) {
    moved = true;
    say("");
    jump(message.frames);
  },
  refused({ robot, x, y }) {
    const at = [x, y].map((part) => (100 * part).toFixed(1)).join(", ");
    say(`There is no room for robot ${robot + 1} at ${at} cm; it stays where it is`);
  },
  step(message) {
    asked = false;
    rate = 0.95 * message.rate;
    frames.push(...message.frames);
  },
  recorded: (message) => waiting?.(message),
};

// Continue from frames to which robots did not drive.
function jump(to) {
  board.clear();
  frames = to;
  clock = pace.time = frames[0].time;
  reach();
}

// Show what the first frame has.
function reach() {
  const { time, robots, outcome, end } = frames[0];
  board.follow(robots);
  plots.forEach(([name, plot]) => plot.add(time, robots.map((robot) => robot[name])));
  if (outcome || (single && end)) setPlaying(false);
  $("step").disabled = Boolean(outcome);
  tell();
  const at = robots.map((r, i) => `robot ${i + 1} at ${(100 * r.x).toFixed(0)}, ${(100 * r.y).toFixed(0)} cm`).join("; ");
  if (end) $("board").setAttribute("aria-label", `Board from above. ${at}. Arrow keys move robot ${selected + 1}`);
}

// How the episode is going.
function tell() {
  const { time, outcome } = frames[0], going = playing || time > 0 ? data.outcomes[0] : "ready";
  $("outcome").textContent = (outcome ? data.outcomes[outcome] : going) + (moved ? ", changed by hand" : "");
}

function setPlaying(plays) {
  playing = plays;
  single &&= plays;
  $("play").textContent = plays ? "Pause" : "Play";
  if (frames.length) tell();
}

// Let time pass, and have the worker compute what comes next.
function advance() {
  const now = performance.now(), speed = Math.min(Number($("speed").value), rate), last = frames.at(-1);
  if (playing) clock = Math.min(clock + (Math.min(now - wall, 250) / 1000) * speed, last.time);
  while (playing && frames[1]?.time <= clock) {
    frames.shift();
    reach();
    if (!playing) clock = frames[0].time;
  }
  wall = now;
  if (!playing || asked || last.outcome || last.time - clock >= Math.max(data.step_s, 0.4 * speed)) return;
  asked = true;
  worker.postMessage({ action: "step", time: clock });
}

// Where robots are between two frames.
function between() {
  const [before, after] = frames;
  if (!after) return before.robots;
  const share = Math.max(0, (clock - before.time) / (after.time - before.time)), mix = (a, b) => a + share * (b - a);
  return after.robots.map((robot, i) => {
    const old = before.robots[i], turn = robot.heading - old.heading;
    const heading = old.heading + share * Math.atan2(Math.sin(turn), Math.cos(turn));
    const theta = robot.theta.map((angle, k) => mix(old.theta[k], angle));
    return { ...robot, x: mix(old.x, robot.x), y: mix(old.y, robot.y), heading, theta };
  });
}

function draw() {
  requestAnimationFrame(draw);
  if (!frames.length) return;
  advance();
  board.draw(between(), { map: $("map").checked, trails: $("trails").checked, selected, downhill, dragged });
  plots.forEach(([, plot]) => plot.draw(selected));
  $("time").textContent = `${clock.toFixed(1)} s`;
  $("path").textContent = `${(100 * frames[0].robots[selected].path).toFixed(1)} cm`;
  $("of").textContent = selected + 1;
  if (!playing) $("pace").textContent = frames[0].outcome ? "ended" : "paused";
  else if (wall - pace.wall > 500) {
    $("pace").textContent = `${((1000 * (clock - pace.time)) / (wall - pace.wall)).toFixed(1)}×`;
    pace = { wall, time: clock };
  }
}

// A number of a field; an error of its name and limits if it is none.
function numberOf(id, name) {
  const { valueAsNumber: value, min, max } = $(id), whole = id === "seed";
  if (value >= Number(min) && value <= Number(max) && (!whole || Number.isInteger(value))) return value;
  const expected = `${whole ? "a whole number" : "a number"} from ${min} to ${max}`;
  throw new Error(`${name} = ${$(id).value || "nothing"} is invalid; give ${expected}`);
}

function restart(given = {}) {
  try {
    const [seed, mu, noise] = [numberOf("seed", "seed"), numberOf("mu", "friction"), numberOf("noise", "speed noise")];
    const options = { seed, mu, noise, shielded: $("shielded").checked, ...given };
    setPlaying(false);
    worker.postMessage({ action: "begin", world: Number($("world").value), options, number: ++number });
    say("");
  } catch (error) {
    say(error.message);
  }
}

function toggle() {
  if (!frames.length) return;
  if (frames[0].outcome) restart();
  setPlaying(!playing);
}

function choose(robot) {
  if (robot < scenario.targets.length) $("robot").value = selected = robot;
}

// Another world, with the values that it begins with.
function enter(world) {
  const { patches, edge, mu, noise, shielded, friction } = data.worlds[world].facts;
  board = new Board($("board"), { ...scenario, patches, edge }, machine);
  [$("mu").value, $("noise").value] = [mu, noise];
  [$("with-shield").hidden, $("with-mu").hidden] = [!shielded, !friction.length];
  restart();
}

// Put a robot elsewhere in the moment that is shown, whatever the worker has computed of its future.
function place(robot, x, y) {
  setPlaying(false);
  if (frames[0].outcome) say("The episode has ended; restart it to move robots");
  else worker.postMessage({ action: "place", robot, x, y, time: clock });
}

const faster = (by) => ($("speed").value = SPEEDS[SPEEDS.indexOf(Number($("speed").value)) + by] ?? $("speed").value);
const keys = { " ": toggle, ".": () => $("step").click(), r: () => restart(), "+": () => faster(1), "-": () => faster(-1) };
const steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowDown: [0, -1], ArrowUp: [0, 1] };
const touched = (event) => (frames.length ? board.robotAt(event, between()) : -1);

function listen() {
  $("play").onclick = toggle;
  $("step").onclick = () => {
    setPlaying(true);
    single = true;
  };
  $("restart").onclick = () => restart();
  for (const id of ["seed", "mu", "noise", "shielded"]) $(id).onchange = () => restart();
  $("world").onchange = () => enter(Number($("world").value));
  $("robot").onchange = () => choose(Number($("robot").value));
  $("board").onpointerdown = (event) => {
    const robot = touched(event);
    if (robot < 0) return;
    choose(robot);
    $("board").setPointerCapture(event.pointerId);
    dragged = { robot, from: [event.clientX, event.clientY] };
  };
  $("board").onpointermove = (event) => {
    if (!dragged || (!dragged.to && Math.hypot(event.clientX - dragged.from[0], event.clientY - dragged.from[1]) < 4)) return;
    setPlaying(false);
    dragged.to = board.placeOf(event);
  };
  $("board").onpointerup = () => {
    if (dragged?.to) place(dragged.robot, ...dragged.to);
    dragged = null;
  };
  $("board").onpointercancel = () => (dragged = null);
  const hold = (event) => touched(event.touches[0]) >= 0 && event.preventDefault(); // no scrolling
  $("board").addEventListener("touchstart", hold, { passive: false });
  $("board").onkeydown = (event) => {
    const by = steps[event.key];
    if (!by || !frames.length) return;
    event.preventDefault();
    const { x, y } = between()[selected];
    place(selected, x + by[0] * scenario.cell_m, y + by[1] * scenario.cell_m);
  };
  $("controls").onsubmit = (event) => event.preventDefault();
  addEventListener("keydown", (event) => {
    const { key, target } = event, space = key === " " && target.matches("button, input, summary");
    if (event.ctrlKey || event.metaKey || event.altKey || space || target.matches("input[type=number], select")) return;
    if (key >= "1" && key <= "9") choose(Number(key) - 1);
    if (!keys[key]) return;
    event.preventDefault();
    keys[key]();
  });
}

// The explanation is open on the first visit where there is room next to the board.
function explain() {
  let known = false;
  try {
    known = localStorage.getItem("minirobots-explained");
    localStorage.setItem("minirobots-explained", "yes");
  } catch {} // a browser that keeps nothing of a file's
  $("explained").open = !known && matchMedia("(min-width: 860px)").matches;
}

// What is shown, for tests.
window.shown = () => {
  const { time, outcome } = frames.at(-1), { scale, origin } = board;
  const robots = between(), theta = robots.map((robot) => robot.theta), headings = robots.map((robot) => robot.heading);
  const trails = board.trails.map((trail) => trail.length);
  return { robots: robots.map(({ x, y }) => [x, y]), theta, headings, trails, downhill, time: clock, ahead: time - clock, ends: Boolean(outcome), scale, origin };
};

// An episode as fast as it goes: how it ended, and positions at the end of every RL step.
window.recordEpisode = (given) =>
  new Promise((done) => {
    waiting = done;
    restart(given);
    worker.postMessage({ action: "record" });
  });

if (typeof DecompressionStream === "undefined") throw new Error("this browser is too old: it has no DecompressionStream; update it");
scenario.targets.forEach((_, i) => $("robot").add(new Option(i + 1, i)));
data.worlds.forEach(({ name }, k) => $("world").add(new Option(name, k)));
$("with-world").hidden = data.worlds.length < 2;
$("seed").value = data.seed;
worker.postMessage({ action: "load", worlds: data.worlds });
listen();
explain();
enter(0);
draw();
