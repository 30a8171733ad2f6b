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
    for (const place of facts.friction) this.values("play.state.properties")[place] = mu;
    machine.set("play.amplitude", noise);
    machine.set("play.plant.shielded", shielded);
    facts.generators.forEach((keys, k) => {
      const words = this.values("keys");
      words.set(keys);
      machine.exports.seed_generator(this.values("generators").subarray(4 * k).byteOffset, BigInt(seed), words.byteOffset, keys.length);
    });
    this.values("play.cells").set(this.drawStarts().flat().map(BigInt));
    this.fill(1, this.values("play.varied.draws"));
    if (machine.call("start") < 0) throw new Error("the motors refuse what the world has drawn");
    Object.assign(this, { time: 0, outcome: 0, periods: 0, paths: this.robots.map(() => 0), corners: this.robots.map((i) => this.placeOf(i)) });
  }

  // Start cells, again while any two robots would touch.
  drawStarts() {
    const { starts, contact } = this.facts, chance = this.values("chance");
    for (;;) {
      this.fill(0, chance);
      const cells = starts.map((cells, i) => cells[Math.floor(cells.length * chance[i])]);
      if (cells.every(([x, y], i) => cells.every(([u, v], j) => j >= i || (u - x) ** 2 + (v - y) ** 2 > contact))) return cells;
    }
  }

  // The uniform numbers of the next RL step.
  draw() {
    const { facts } = this, periods = this.machine.array("play.noise").shape[0];
    const count = Math.max(0, Math.ceil((periods - Number(this.values("play.left")[0])) / facts.hold));
    let generator = 2;
    for (const name of ["play.noise_draws", "play.sight_draws"]) {
      const [rows, width] = this.machine.array(name).shape, used = name === "play.noise_draws" ? count : width;
      for (let row = 0; row < rows * (width > 0); row++)
        this.fill(generator++, this.values(name).subarray(row * width, row * width + used));
    }
    const used = Number(this.values("play.moves.counts")[facts.used]), detours = this.values("play.moves.detours");
    detours.copyWithin(0, used);
    this.fill(generator, detours.subarray(detours.length - used));
    this.values("play.moves.counts")[facts.used] = 0n;
  }

  // One RL step; the frames of it, the last one at its end.
  step() {
    this.draw();
    this.outcome = this.machine.call("step");
    if (this.outcome < 0) throw new Error("motors or bodies failed");
    const { frame_periods, ticks, dt_s } = this.facts, frames = [], count = Number(this.values("play.state.periods")[0]);
    for (let row = 0; row < count; row++) {
      this.time = ++this.periods * ticks * dt_s;
      if (this.periods % frame_periods && row < count - 1) continue;
      const samples = this.machine.array("play.samples.position");
      this.measure(samples, row);
      frames.push(this.frame(row));
    }
    frames.at(-1).end = true;
    frames.at(-1).outcome = this.outcome;
    return frames;
  }

  // Add to the robots' paths, every few frames: each vibration would add to them.
  measure({ values, shape }, row) {
    if (this.periods % this.facts.path_periods) return;
    for (const robot of this.robots) {
      const [x, y] = values.subarray(3 * (row * shape[1] + robot)), [before, below] = this.corners[robot];
      this.paths[robot] += Math.hypot(x - before, y - below);
      this.corners[robot] = [x, y];
    }
  }

  placeOf(robot) {
    const { values, shape } = this.machine.array("play.state.bodies");
    return [values[robot], values[shape[1] + robot]];
  }

  // What is shown of a row of the samples.
  frame(row) {
    const part = (name, robot) => {
      const { values, shape: [, columns, size = 1] } = this.machine.array(`play.samples.${name}`), at = size * (row * columns + robot);
      return [...values.subarray(at, at + size)];
    };
    const robots = this.robots.map((robot) => this.robot(robot, part("position", robot), part("quaternion", robot), {
      moving: part("mode", robot)[0] !== this.facts.hold_mode,
      theta: part("theta", robot), omega: part("omega", robot), voltage: part("voltage", robot),
      force: part("normal_mean", robot),
    }));
    return { time: this.time, robots };
  }

  // What is shown of robots that stand.
  still() {
    const bodies = this.machine.array("play.state.bodies"), { motors, feet } = this.facts;
    const robots = this.robots.map((robot) => {
      const body = (first, count) => Array.from({ length: count }, (_, k) => bodies.values[(first + k) * bodies.shape[1] + robot]);
      const nothing = { omega: Array(motors).fill(0), voltage: Array(motors).fill(0), force: Array(feet).fill(0) };
      const outputs = this.machine.array("play.state.outputs");
      const theta = Array.from({ length: motors }, (_, k) => outputs.values[k * outputs.shape[1] + robot]);
      return this.robot(robot, body(0, 3), body(3, 4), { moving: false, theta, ...nothing });
    });
    return { time: this.time, robots, end: true, outcome: this.outcome };
  }

  robot(robot, [x, y], [w, i, j, k], more) {
    const { values, shape: [, size] } = this.machine.array("play.state.commands"), at = size * robot;
    const heading = Math.atan2(2 * (w * k + i * j), 1 - 2 * (j * j + k * k));
    return { x, y, heading, goal: [...values.subarray(at, at + 2)], path: this.paths[robot], ...more };
  }

  // Put a robot where there is room; whether there was.
  place(robot, x, y) {
    this.values("asked").set([robot, x, y]);
    return this.machine.call("place") > 0;
  }

  // Where the floor falls, as an angle from +x; null on a level one.
  downhill() {
    const { values, shape } = this.machine.array("play.state.properties"), [x, y] = [0, 1].map((k) => values[(this.facts.gravity + k) * shape[1]]);
    return x || y ? Math.atan2(y, x) : null;
  }
}
