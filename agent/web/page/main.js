// The page: controls, readout, plots, and a worker that computes.
const OUTCOMES = ["running", "time-out", "success", "collision", "out of the board"];
const SPEEDS = [1, 5, 10, 30, 60];
const $ = (id) => document.getElementById(id);

function say(text) {
  $("error").textContent = text;
  $("error").hidden = false;
}

// What the page cannot recover from.
function fail(text) {
  say(text);
  $("outcome").textContent = "error";
  window.pageError = text;
}
addEventListener("error", (event) => fail(event.message));
addEventListener("unhandledrejection", (event) => fail(String(event.reason?.message ?? event.reason)));

const data = JSON.parse($("data").textContent);
const { scenario, layout } = data;
const own = { targets: scenario.targets, maps: scenario.maps };
const board = new Board($("board"), scenario);
const plots = [
  ["omega", "Motor speeds ω", "rad/s", ["D", "E"]],
  ["voltage", "Motor voltages", "V", ["D", "E"]],
  ["force", "Contact forces of the feet, mean of 1 ms", "N", ["A", "B", "C"]],
].map(([name, ...shown]) => [name, new Plot($(name), $(`${name}-title`), ...shown)]);
let before, now, playing = false, ready = false, selected = 0, waiting, world, moved = false, dragged = null, pace = { wall: 0, time: 0 };

const bytesOf = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));

async function inflated(text) {
  const stream = new Blob([bytesOf(text)]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Response(stream).arrayBuffer();
}

// A table; of one with many zeros a bit for each number says whether it is another, and bytes follow.
async function unpacked(kept) {
  if (typeof kept === "string") return inflated(kept);
  const [mask, halves] = (await Promise.all(kept.map(inflated))).map((buffer) => new Uint8Array(buffer));
  const table = new Uint16Array(8 * mask.length), upper = halves.length / 2;
  for (let i = 0, k = 0; i < table.length; i++)
    if (mask[i >> 3] & (128 >> (i & 7))) table[i] = halves[k] | (halves[upper + k++] << 8);
  return table.buffer;
}

// Robots of a view, which is one record of numbers.
function read(view) {
  const part = (name, i, count) => view.slice(layout.view[name][0] + count * i, layout.view[name][0] + count * (i + 1));
  return {
    time: view[layout.view.time_s[0]],
    outcome: view[layout.view.outcome[0]],
    robots: scenario.targets.map((_, i) => {
      const [x, y] = part("position", i, 3), [heading] = part("heading", i, 1);
      return {
        x, y, heading,
        goal: part("goal", i, 2), mode: part("mode", i, 1)[0], arrived: part("arrived", i, 1)[0],
        theta: part("theta", i, 2), omega: [...part("omega", i, 2)], voltage: [...part("voltage", i, 2)],
        force: [...part("force", i, 3)], path: part("path_m", i, 1)[0],
      };
    }),
  };
}

const worker = new Worker(URL.createObjectURL(new Blob([$("worker").textContent], { type: "text/javascript" })));
worker.onerror = (event) => fail(`the computation stopped: ${event.message}`);
worker.onmessage = ({ data: message }) => {
  if (message.kind === "error") return fail(message.text);
  if (message.kind === "recorded") waiting?.(message);
  take(message);
};

function take({ kind, view, playing: plays = false, targets, maps }) {
  const wall = performance.now();
  if (kind === "begun") {
    board.clear();
    plots.forEach(([, plot]) => plot.clear());
    before = undefined;
    pace = { wall, time: 0 };
  } else before = now;
  now = { ...read(view), wall };
  if (kind === "placed") board.clear(); // robots did not drive there
  if (kind === "aimed") show({ targets, maps });
  board.follow(now.robots);
  plots.forEach(([name, plot]) => plot.add(now.time, now.robots.map((robot) => robot[name])));
  setPlaying(plays);
  ready = true;
  for (const id of ["play", "step", "restart"]) $(id).disabled = false;
  $("step").disabled = now.outcome !== 0;
  moved = kind === "placed" || kind === "aimed" || (moved && kind !== "begun");
  $("outcome").textContent = OUTCOMES[now.outcome] + (moved ? ", changed by hand" : "");
}

function show(part) {
  Object.assign(scenario, part);
  board.mapKey = undefined;
}

function setPlaying(plays) {
  playing = plays;
  $("play").textContent = plays ? "Pause" : "Play";
}

// Where robots are between the last two views.
function between() {
  if (!before || !playing) return now.robots;
  const share = Math.min(1, (performance.now() - now.wall) / Math.max(1, now.wall - before.wall));
  const mix = (a, b) => a + share * (b - a);
  return now.robots.map((robot, i) => {
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
  if (now) {
    board.draw(between(), { map: $("map").checked, trails: $("trails").checked, selected });
    plots.forEach(([, plot]) => plot.draw(selected));
    $("time").textContent = `${now.time.toFixed(1)} s`;
    $("path").textContent = now.robots.map((r) => `${(100 * r.path).toFixed(1)}`).join(" / ") + " cm";
    if (now.wall - pace.wall > 500) {
      $("pace").textContent = playing ? `${((1000 * (now.time - pace.time)) / (now.wall - pace.wall)).toFixed(1)}×` : "paused";
      pace = { wall: now.wall, time: now.time };
    }
    if (!playing) $("pace").textContent = now.outcome ? "ended" : "paused";
  }
  requestAnimationFrame(draw);
}

// A number of a field; an error of its name and limits if it is none.
function numberOf(id, name) {
  const field = $(id), value = field.valueAsNumber;
  if (!(value >= Number(field.min) && value <= Number(field.max)) || (id === "seed" && !Number.isInteger(value)))
    throw new Error(`${name} = ${field.value || "nothing"} is invalid; give ${id === "seed" ? "a whole number" : "a number"} from ${field.min} to ${field.max}`);
  return value;
}

const options = () => ({
  seed: numberOf("seed", "seed"), mu: numberOf("mu", "friction"), noise: numberOf("noise", "speed noise"),
  shielded: world.shielded && $("shielded").checked ? 1 : 0,
});

function send(message) {
  try {
    worker.postMessage(typeof message === "function" ? message() : message);
    $("error").hidden = true;
  } catch (error) {
    say(error.message);
  }
}

const restart = () => send(() => ({ action: "begin", ...options() }));
const play = (plays) => send({ action: "play", playing: plays, speed: Number($("speed").value) });

function toggle() {
  if (!ready) return;
  if (!playing && now.outcome) restart();
  setPlaying(!playing);
  play(playing);
}

function choose(robot) {
  if (robot < 0 || robot >= scenario.targets.length) return;
  selected = robot;
  $("robot").value = robot;
}

const keys = {
  " ": toggle,
  ".": () => $("step").click(),
  r: restart,
  "+": () => shift(1),
  "-": () => shift(-1),
};

function shift(by) {
  const place = SPEEDS.indexOf(Number($("speed").value)) + by;
  if (SPEEDS[place]) $("speed").value = SPEEDS[place];
  if (playing) play(true);
}

function listen() {
  $("play").onclick = toggle;
  $("step").onclick = () => {
    play(false);
    send({ action: "step" });
  };
  $("restart").onclick = restart;
  $("speed").onchange = () => playing && play(true);
  for (const id of ["seed", "mu", "noise", "shielded"]) $(id).onchange = restart;
  $("world").onchange = () => enter(Number($("world").value));
  $("robot").onchange = () => choose(Number($("robot").value));
  const place = (robot, x, y) => send({ action: "place", robot, x, y });
  const aim = (x, y) => scenario.any_target && ready && send({ action: "aim", robot: selected, x: Math.floor(x), y: Math.floor(y) });
  let grabs = false;
  $("board").onclick = (event) => grabs || aim(...board.placeOf(event).map((m) => m / scenario.cell_m));
  $("board").onpointerdown = (event) => {
    const robot = now ? board.robotAt(event, now.robots) : -1;
    grabs = robot >= 0;
    if (!grabs) return;
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
    if (now && board.robotAt(event.touches[0], now.robots) >= 0) event.preventDefault(); // no scrolling
  }, { passive: false });
  $("board").onkeydown = (event) => {
    const by = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowDown: [0, -1], ArrowUp: [0, 1] }[event.key];
    if (!by) return;
    event.preventDefault();
    const { x, y } = now.robots[selected], [column, row] = scenario.targets[selected];
    if (event.shiftKey) aim(column + by[0], row + by[1]);
    else place(selected, x + by[0] * scenario.cell_m, y + by[1] * scenario.cell_m);
  };
  $("controls").onsubmit = (event) => event.preventDefault();
  addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.target.matches("input[type=number], select") || (event.key === " " && event.target.matches("button, input, summary"))) return;
    if (event.key >= "1" && event.key <= "8") return choose(Number(event.key) - 1);
    if (keys[event.key]) {
      event.preventDefault();
      keys[event.key]();
    }
  });
}

// What is shown, for tests.
window.shown = () => ({ world: world.name, targets: scenario.targets, map: scenario.maps[selected].action, robots: now.robots.map(({ x, y }) => [x, y]), scale: board.scale, rows_m: board.rows_m });

// An episode as fast as it goes: how it ended, and positions at the end of every decision step.
window.recordEpisode = (given) =>
  new Promise((done) => {
    waiting = done;
    send(() => ({ action: "record", ...options(), ...given }));
  });

// Another world: its setup, its tables, and the values that it begins with.
async function enter(place) {
  const chosen = data.worlds[place];
  const [setup, ...tables] = await Promise.all([chosen.setup, ...chosen.tables].map(inflated));
  world = chosen;
  worker.postMessage({ action: "enter", setup: new Float64Array(setup), tables, places: data.of_worlds });
  show({ ...own, patches: world.patches });
  $("mu").value = world.mu;
  $("noise").value = world.noise;
  $("with-shield").hidden = !world.shielded;
  restart();
}

async function start() {
  if (typeof DecompressionStream === "undefined") throw new Error("this browser is too old: it has no DecompressionStream; update it");
  scenario.targets.forEach((_, i) => $("robot").add(new Option(`r${i + 1}`, i)));
  data.worlds.forEach(({ name }, k) => $("world").add(new Option(name, k)));
  $("with-targets").hidden = !scenario.any_target;
  $("with-world").hidden = data.worlds.length < 2;
  $("seed").value = data.seed;
  const [wasm, ...tables] = await Promise.all([data.wasm, ...data.tables].map(unpacked));
  listen();
  worker.postMessage({ action: "load", wasm, layout, tables });
  await enter(0);
  requestAnimationFrame(draw);
}

start().catch((error) => fail(error.message));
