// The page: controls, readout, plots, and what a worker computes ahead of what is shown.
const SPEEDS = [1, 5, 10, 30, 60];
// Frames that are known, from the one that is shown on; clock: simulated time that is shown
let board, frames = [], clock = 0, wall = performance.now(), number = 0;
let playing = false, single = false, asked = false, rate = Infinity, moved = false, selected = 0, dragged = null;
let downhill = null, pace = { wall: 0, time: 0 }, waiting;
const $ = (id) => document.getElementById(id);

function say(text) {
  $("error").textContent = text;
  $("error").hidden = false;
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
const { machine } = data, [motors, feet] = [machine.motors, machine.feet].map((parts) => parts.map(([name]) => name));
const plots = [
  ["omega", "Motor speeds ω", "rad/s", motors],
  ["voltage", "Motor voltages", "V", motors],
  ["force", "Contact forces of the feet, mean of 1 ms", "N", feet],
].map(([name, ...shown]) => [name, new Plot($(name), $(`${name}-title`), ...shown)]);

const worker = new Worker(URL.createObjectURL(new Blob([$("worker").textContent], { type: "text/javascript" })));
worker.onerror = (event) => fail(`the computation stopped: ${event.message}`);
worker.onmessage = ({ data: message }) => {
  if (message.kind === "error") return fail(message.text);
  if (message.number !== number) return; // of an episode that was given up
  if (message.kind === "recorded") return waiting?.(message);
  take[message.kind](message);
};

const take = {
  begun(message) {
    board.clear();
    plots.forEach(([, plot]) => plot.clear());
    [asked, moved, downhill] = [false, false, message.downhill];
    jump(message.frames);
    for (const id of ["play", "step", "restart"]) $(id).disabled = false;
  },
  placed(message) {
    board.clear(); // robots did not drive there
    moved = true;
    jump(message.frames);
  },
  step(message) {
    asked = false;
    rate = 0.95 * message.rate;
    frames.push(...message.frames);
  },
};

function jump(to) {
  frames = to;
  clock = pace.time = frames[0].time;
  reach();
}

// Show what the first frame has.
function reach() {
  const { time, robots, outcome } = frames[0];
  board.follow(robots);
  plots.forEach(([name, plot]) => plot.add(time, robots.map((robot) => robot[name])));
  if (outcome || (single && frames[0].end)) setPlaying(false);
  $("step").disabled = Boolean(outcome);
  $("outcome").textContent = data.outcomes[outcome ?? 0] + (moved ? ", changed by hand" : "");
  const at = robots.map((r, i) => `robot ${i + 1} at ${(100 * r.x).toFixed(0)}, ${(100 * r.y).toFixed(0)} cm`).join("; ");
  if (frames[0].end) $("board").setAttribute("aria-label", `Board from above. ${at}. Arrow keys move robot ${selected + 1}`);
}

function setPlaying(plays) {
  playing = plays;
  single &&= plays;
  $("play").textContent = plays ? "Pause" : "Play";
}

// Let time pass, and have the worker compute what comes next.
function advance() {
  const now = performance.now(), speed = Number($("speed").value);
  if (playing) {
    clock = Math.min(clock + (Math.min(now - wall, 250) / 1000) * Math.min(speed, rate), frames.at(-1).time);
    while (playing && frames.length > 1 && frames[1].time <= clock) {
      frames.shift();
      reach();
    }
    if (!playing) clock = frames[0].time;
    const { time, outcome } = frames.at(-1), ahead = Math.max(data.step_s, 0.4 * Math.min(speed, rate));
    if (playing && !asked && !outcome && time - clock < ahead) {
      asked = true;
      worker.postMessage({ action: "step" });
    }
  }
  wall = now;
}

// Where robots are between two frames.
function between() {
  const [before, after] = frames;
  if (!after) return before.robots;
  const share = Math.max(0, (clock - before.time) / (after.time - before.time)), mix = (a, b) => a + share * (b - a);
  return after.robots.map((robot, i) => {
    const old = before.robots[i], turn = robot.heading - old.heading;
    return {
      ...robot,
      x: mix(old.x, robot.x), y: mix(old.y, robot.y),
      heading: old.heading + share * Math.atan2(Math.sin(turn), Math.cos(turn)),
      theta: robot.theta.map((angle, k) => mix(old.theta[k], angle)),
    };
  });
}

function draw() {
  requestAnimationFrame(draw);
  if (!frames.length) return;
  advance();
  board.draw(between(), { map: $("map").checked, trails: $("trails").checked, selected, downhill });
  plots.forEach(([, plot]) => plot.draw(selected));
  $("time").textContent = `${clock.toFixed(1)} s`;
  $("path").textContent = `${(100 * frames[0].robots[selected].path).toFixed(1)} cm`;
  $("of").textContent = selected + 1;
  if (wall - pace.wall > 500) {
    $("pace").textContent = `${((1000 * (clock - pace.time)) / (wall - pace.wall)).toFixed(1)}×`;
    pace = { wall, time: clock };
  }
  if (!playing) $("pace").textContent = frames[0].outcome ? "ended" : "paused";
}

// A number of a field; an error of its name and limits if it is none.
function numberOf(id, name) {
  const field = $(id), value = field.valueAsNumber, whole = id === "seed";
  if (!(value >= Number(field.min) && value <= Number(field.max)) || (whole && !Number.isInteger(value)))
    throw new Error(`${name} = ${field.value || "nothing"} is invalid; give ${whole ? "a whole number" : "a number"} from ${field.min} to ${field.max}`);
  return value;
}

const options = () => ({
  seed: numberOf("seed", "seed"), mu: numberOf("mu", "friction"), noise: numberOf("noise", "speed noise"),
  shielded: $("shielded").checked,
});

function restart(given = {}) {
  try {
    const begin = { action: "begin", world: Number($("world").value), options: { ...options(), ...given }, number: number + 1 };
    number++;
    setPlaying(false);
    worker.postMessage(begin);
    $("error").hidden = true;
  } catch (error) {
    say(error.message);
  }
}

function toggle() {
  if (!frames.length) return;
  const ended = frames[0].outcome;
  if (ended) restart();
  setPlaying(!playing);
}

function choose(robot) {
  if (robot < 0 || robot >= board.scenario.targets.length) return;
  $("robot").value = selected = robot;
}

// Another world, with the values that it begins with.
function enter(world) {
  const { patches, edge, mu, noise, shielded, friction } = data.worlds[world].facts;
  board = new Board($("board"), { ...data.scenario, patches, edge }, machine);
  $("mu").value = mu;
  $("noise").value = noise;
  $("with-shield").hidden = !shielded;
  $("with-mu").hidden = !friction.length;
  restart();
}

const keys = {
  " ": toggle,
  ".": () => $("step").click(),
  r: () => restart(),
  "+": () => shift(1),
  "-": () => shift(-1),
};

const shift = (by) => ($("speed").value = SPEEDS[SPEEDS.indexOf(Number($("speed").value)) + by] ?? $("speed").value);

function listen() {
  const place = (robot, x, y) => {
    setPlaying(false);
    worker.postMessage({ action: "place", robot, x, y });
  };
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
    const robot = frames.length ? board.robotAt(event, frames[0].robots) : -1;
    if (robot < 0) return;
    choose(robot);
    $("board").setPointerCapture(event.pointerId);
    dragged = { robot, from: [event.clientX, event.clientY] };
  };
  $("board").onpointermove = (event) => {
    if (!dragged || Math.hypot(event.clientX - dragged.from[0], event.clientY - dragged.from[1]) < 4) return;
    dragged.from = [-1e9, 0]; // no click any more
    place(dragged.robot, ...board.placeOf(event));
  };
  $("board").onpointerup = $("board").onpointercancel = () => (dragged = null);
  $("board").addEventListener("touchstart", (event) => {
    if (frames.length && board.robotAt(event.touches[0], frames[0].robots) >= 0) event.preventDefault(); // no scrolling
  }, { passive: false });
  $("board").onkeydown = (event) => {
    const by = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowDown: [0, -1], ArrowUp: [0, 1] }[event.key];
    if (!by || !frames.length) return;
    event.preventDefault();
    const { x, y } = frames[0].robots[selected], { cell_m } = data.scenario;
    place(selected, x + by[0] * cell_m, y + by[1] * cell_m);
  };
  $("controls").onsubmit = (event) => event.preventDefault();
  addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.target.matches("input[type=number], select") || (event.key === " " && event.target.matches("button, input, summary"))) return;
    if (event.key >= "1" && event.key <= "9") return choose(Number(event.key) - 1);
    if (keys[event.key]) {
      event.preventDefault();
      keys[event.key]();
    }
  });
}

// The explanation is open on the first visit.
function explain() {
  try {
    $("explained").open = !localStorage.getItem("minirobots-explained");
    localStorage.setItem("minirobots-explained", "yes");
  } catch {
    $("explained").open = true; // a browser that keeps nothing of a file's
  }
}

// What is shown, for tests.
window.shown = () => ({ robots: frames[0].robots.map(({ x, y }) => [x, y]), scale: board.scale, origin: board.origin, number });

// An episode as fast as it goes: how it ended, and positions at the end of every RL step.
window.recordEpisode = (given) =>
  new Promise((done) => {
    waiting = done;
    restart(given);
    worker.postMessage({ action: "record" });
  });

if (typeof DecompressionStream === "undefined") throw new Error("this browser is too old: it has no DecompressionStream; update it");
data.scenario.targets.forEach((_, i) => $("robot").add(new Option(i + 1, i)));
data.worlds.forEach(({ name }, k) => $("world").add(new Option(name, k)));
$("with-world").hidden = data.worlds.length < 2;
$("seed").value = data.seed;
worker.postMessage({ action: "load", worlds: data.worlds });
listen();
explain();
enter(0);
requestAnimationFrame(draw);
