// Runs the compiled episode apart from the page, so that drawing stays smooth.
"use strict";

const SLICE_MS = 14; // of computing between two messages
const CHUNK_PERIODS = 10;

const next = new MessageChannel(); // a timer would wait for 4 ms
next.port1.onmessage = () => play();

let c, layout, playing = false, speed = 1, began = { wall: 0, time: 0 };

const numbers = (pointer, record) => {
  const last = Object.values(record).at(-1);
  return new Float64Array(c.memory.buffer, pointer, last[0] + last[1]);
};
const setup = () => numbers(c.episode_setup(), layout.setup);
const view = () => numbers(c.episode_view(), layout.view);
const of = (name) => view()[layout.view[name][0]];

function load(message) {
  const module = new WebAssembly.Module(message.wasm);
  c = new WebAssembly.Instance(module, {}).exports;
  c._initialize?.();
  layout = message.layout;
  message.tables.forEach((bytes, place) => fill(place, bytes));
}

function fill(place, bytes) {
  const pointer = c.episode_table(place, bytes.byteLength);
  if (bytes.byteLength && !pointer) throw new Error("there is not enough memory for the policy");
  new Uint8Array(c.memory.buffer, pointer, bytes.byteLength).set(new Uint8Array(bytes));
}

function begin({ seed, mu, noise, shielded }) {
  setup()[layout.setup.mu[0]] = mu;
  setup()[layout.setup.noise[0]] = noise;
  setup()[layout.setup.shielded[0]] = shielded;
  if (c.episode_begin(seed, 0) < 0) throw new Error("the robots' start cells leave no room");
  playing = false;
  post("begun");
}

const post = (kind, more = {}) => postMessage({ kind, view: view().slice(), ...more });

// Advance to where play at the wanted speed has come, or as far as there is time for.
function play() {
  if (!playing) return;
  const due = began.time + ((performance.now() - began.wall) / 1000) * speed;
  const until = performance.now() + SLICE_MS;
  let ended = 0;
  while (!ended && of("time_s") < due && performance.now() < until) ended = c.episode_advance(CHUNK_PERIODS);
  const late = of("time_s") < due;
  if (late) resume(); // slower than wanted: never catch up in a jump
  playing = !ended;
  post("frame", { playing });
  if (late) next.port2.postMessage(0);
  else setTimeout(play, SLICE_MS);
}

function resume() {
  began = { wall: performance.now(), time: of("time_s") };
}

const periodsOfStep = () => setup()[layout.setup.decision_periods[0]];

// A whole episode as fast as it goes, with the positions at the end of every RL step.
function record(message) {
  begin(message);
  const robots = setup()[layout.setup.robots[0]], [start] = layout.view.position;
  const positions = [], wall = performance.now();
  let outcome = 0;
  while (!outcome) {
    outcome = c.episode_advance(periodsOfStep());
    positions.push([...view().slice(start, start + 3 * robots)]);
  }
  const wall_s = (performance.now() - wall) / 1000;
  post("recorded", { outcome, positions, wall_s, time_s: of("time_s") });
}

const actions = {
  load,
  enter(world) {
    setup().set(world.setup);
    world.tables.forEach((bytes, k) => fill(world.places[k], bytes));
  },
  begin,
  record,
  play(message) {
    const before = playing;
    playing = message.playing;
    speed = message.speed;
    resume();
    if (playing && !before) play();
    if (!playing) post("frame", { playing }); // after those under way
  },
  aim({ robot, x, y }) {
    if (!c.episode_aim(robot, x, y)) return;
    const all = setup(), of = (name, i) => all[layout.setup[name][0] + i];
    const robots = Array.from({ length: of("robots", 0) }, (_, i) => i), cells = [];
    for (let column = 0; column < of("columns", 0); column++)
      for (let row = 0; row < of("rows", 0); row++) cells.push([column, row]);
    const targets = robots.map((i) => [of("targets", 2 * i), of("targets", 2 * i + 1)]);
    const maps = robots.map((i) => {
      const seen = cells.map((cell) => [c.episode_value(i, ...cell), c.episode_best()]);
      return { value: seen.map(([value]) => (value === value ? value : null)), action: seen.map(([, best]) => best) };
    });
    post("aimed", { playing, targets, maps });
  },
  place({ robot, x, y }) {
    if (c.episode_place(robot, x, y)) post("placed", { playing });
  },
  step() {
    c.episode_advance(periodsOfStep());
    post("frame", { playing: false });
  },
};

onmessage = ({ data }) => {
  try {
    actions[data.action](data);
  } catch (error) {
    postMessage({ kind: "error", text: String(error.message ?? error) });
  }
};
