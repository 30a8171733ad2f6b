// An episode of compiled kernels: fills in the uniform numbers that they use, reads what they sample.
class Episode {
  constructor(wasm, image, layout, facts) {
    Object.assign(this, { machine: new Machine(wasm, image, layout), facts });
    this.robots = facts.starts.map((_, robot) => robot);
  }

  values(name) {
    return this.machine.array(name).values;
  }

  // Fill an array with the next numbers of a generator.
  fill(generator, out) {
    this.machine.exports.fill_uniforms(this.values("generators").subarray(4 * generator).byteOffset, out.byteOffset, out.length);
  }

  begin({ seed, mu, noise, shielded }) {
    const { facts, machine } = this;
    machine.reset();
    for (const place of facts.friction) this.values("state.bodies.properties")[place] = mu;
    machine.set("amplitude", noise);
    machine.set("plant.shielded", facts.shielded && shielded);
    facts.keys.forEach((keys, k) => {
      const words = this.values("keys"), generator = this.values("generators").subarray(4 * k);
      words.set(keys);
      machine.exports.seed_generator(generator.byteOffset, BigInt(seed), words.byteOffset, keys.length);
    });
    this.values("cells").set(this.drawStarts().flat().map(BigInt));
    this.fill(1, this.values("varied.draws"));
    if (machine.call("start")) throw new Error("the motors refuse what the world has drawn");
    Object.assign(this, { time: 0, outcome: 0, periods: 0, paths: this.robots.map(() => 0), past: [] });
    this.corners = this.robots.map((robot) => this.body(robot, 0, 2));
  }

  // Start cells, again while any two robots would touch.
  drawStarts() {
    const { starts, contact } = this.facts, chance = this.values("chance");
    for (;;) {
      this.fill(0, chance);
      const cells = starts.map((cells, i) => cells[Math.floor(cells.length * chance[i])]);
      const apart = ([x, y], i) => cells.every(([u, v], j) => j >= i || (u - x) ** 2 + (v - y) ** 2 > contact);
      if (cells.every(apart)) return cells;
    }
  }

  // All that changes, without what is kept of the past.
  saved() {
    const { time, outcome, periods, paths, corners, machine } = this;
    return { memory: machine.saved(), time, outcome, periods, paths: [...paths], corners: [...corners] };
  }

  restore({ memory, paths, corners, ...rest }) {
    this.machine.restore(memory);
    Object.assign(this, rest, { paths: [...paths], corners: [...corners] });
  }

  // Keep what is needed to go back to any moment from one on.
  keep(time) {
    while (this.past[1]?.time <= time) this.past.shift();
    this.past.push(this.saved());
  }

  // Go back to a moment since the first that is kept, to the control period.
  back(time) {
    if (time >= this.time || !this.past.length) return;
    const before = this.past.filter((state) => state.time <= time).at(-1) ?? this.past[0], { ticks, dt_s } = this.facts;
    this.restore(before);
    const periods = Math.floor((time - before.time) / (ticks * dt_s) + 1e-6);
    if (periods > 0) this.step(periods);
  }

  // The uniform numbers of the next control periods.
  draw(periods) {
    const { facts, machine } = this, counts = this.values("moves.counts"), detours = this.values("moves.detours");
    const due = periods - Number(this.values("left")[0]), used = Number(counts[facts.used]);
    let generator = 2;
    for (const [name, count] of [["noise_draws", Math.max(0, Math.ceil(due / facts.hold))], ["sight_draws", Infinity]]) {
      const { values, shape: [rows, width] } = machine.array(name);
      for (let row = 0; row < rows * (width > 0); row++)
        this.fill(generator++, values.subarray(row * width, row * width + Math.min(width, count)));
    }
    detours.copyWithin(0, used);
    this.fill(generator, detours.subarray(detours.length - used));
    counts[facts.used] = 0n;
  }

  // One RL step, or its first control periods; the frames of it.
  step(periods = this.facts.periods) {
    this.machine.set("periods", periods);
    this.draw(periods);
    this.machine.call("decide");
    this.outcome = this.machine.call("step");
    if (this.outcome < 0) throw new Error("the motors failed, or a body is nowhere");
    const { frame_periods, ticks, dt_s } = this.facts, frames = [], count = Number(this.values("state.episodes.periods")[0]);
    for (let row = 0; row < count; row++) {
      this.time = ++this.periods * ticks * dt_s;
      if (this.periods % frame_periods && row < count - 1) continue;
      this.measure(row);
      frames.push({ time: this.time, robots: this.robots.map((robot) => this.sampled(robot, row)) });
    }
    return this.ended(frames);
  }

  // Frames, the last one marked as the end of an RL step.
  ended(frames) {
    Object.assign(frames.at(-1), { end: true, outcome: this.outcome });
    return frames;
  }

  // Add to the robots' paths, every few frames: each vibration would add to them.
  measure(row) {
    if (this.periods % this.facts.path_periods) return;
    for (const robot of this.robots) {
      const [x, y] = this.sample("position", robot, row), [before, below] = this.corners[robot];
      this.paths[robot] += Math.hypot(x - before, y - below);
      this.corners[robot] = [x, y];
    }
  }

  sample(name, robot, row) {
    const { values, shape: [, columns, size = 1] } = this.machine.array(`samples.${name}`), at = size * (row * columns + robot);
    return [...values.subarray(at, at + size)];
  }

  // Rows of a robot in the state of the bodies, or in another array with a column for each.
  body(robot, first, count, name = "state.bodies.motion") {
    const { values, shape } = this.machine.array(name);
    return Array.from({ length: count }, (_, k) => values[(first + k) * shape[1] + robot]);
  }

  // What is shown of a robot, as it was sampled and as it stands.
  sampled(robot, row) {
    const of = (name) => this.sample(name, robot, row), moving = of("mode")[0] !== this.facts.hold_mode;
    const signals = { theta: of("theta"), omega: of("omega"), voltage: of("voltage"), force: of("normal_mean"), bent: of("deflection") };
    return this.shown(robot, of("position"), of("quaternion"), { moving, ...signals });
  }

  still() {
    const { motors, feet } = this.facts, zeros = (count) => Array(count).fill(0);
    const signals = { omega: zeros(motors), voltage: zeros(motors), force: zeros(feet), bent: zeros(3 * feet), moving: false };
    const robots = this.robots.map((robot) => {
      const theta = this.body(robot, 0, motors, "state.motors.outputs");
      return this.shown(robot, this.body(robot, 0, 3), this.body(robot, 3, 4), { theta, ...signals });
    });
    return this.ended([{ time: this.time, robots }]);
  }

  shown(robot, [x, y], [w, i, j, k], more) {
    const { values, shape: [, size] } = this.machine.array("state.onboard.commands"), at = size * robot;
    const heading = Math.atan2(2 * (w * k + i * j), 1 - 2 * (j * j + k * k));
    return { x, y, heading, goal: [...values.subarray(at, at + 2)], path: this.paths[robot], ...more };
  }

  // Put a robot where there is room at a moment, with which the episode continues; whether there was.
  place(robot, x, y, time) {
    const last = this.saved();
    this.back(time);
    this.values("asked").set([robot, x, y]);
    const placed = this.machine.call("place") > 0;
    placed ? Object.assign(this, { outcome: 0, past: [] }) : this.restore(last);
    return placed;
  }

  // Where the floor falls, as an angle from +x; null on a level one.
  downhill() {
    const [x, y] = this.body(0, this.facts.gravity, 2, "state.bodies.properties");
    return x || y ? Math.atan2(y, x) : null;
  }
}
