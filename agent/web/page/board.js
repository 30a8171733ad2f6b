// The top view: board, value map, trails, moves and robots.
const COLOURS = ["#1f83d6", "#d55e00", "#009e73", "#cc79a7", "#b8860b", "#56b4e9", "#8c564b", "#7f7f7f",
  "#5e3c99", "#3a7d00", "#e7298a", "#008b8b", "#a6761d", "#6a5acd", "#c23b22", "#4a6fa5"];
const EIGHTH = Math.PI / 4;
const MARGIN = { left: 26, right: 10, top: 10, bottom: 34 }; // of the board in its canvas, px
const FONT = "px system-ui, sans-serif";

const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

// A canvas with as many pixels as its place on the screen has, cleared, in CSS pixels.
function cleared(canvas) {
  const width = canvas.clientWidth, height = canvas.clientHeight, ratio = window.devicePixelRatio || 1;
  const size = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== size[0] || canvas.height !== size[1]) [canvas.width, canvas.height] = size;
  const g = canvas.getContext("2d");
  g.setTransform(ratio, 0, 0, ratio, 0, 0);
  g.clearRect(0, 0, width, height);
  return [g, width, height];
}

class Board {
  constructor(canvas, scenario, machine) {
    Object.assign(this, { canvas, scenario, machine });
    this.size = [scenario.columns * scenario.cell_m, scenario.rows * scenario.cell_m];
    this.clear();
  }

  clear() {
    this.trails = this.scenario.targets.map(() => []);
  }

  follow(robots) {
    robots.forEach(({ x, y }, i) => {
      const trail = this.trails[i], last = trail.at(-1);
      if (!last || Math.hypot(x - last[0], y - last[1]) > 5e-4) trail.push([x, y]);
    });
  }

  // Place of a pointer in m.
  placeOf(event) {
    const box = this.canvas.getBoundingClientRect(), [left, bottom] = this.origin;
    return [(event.clientX - box.left - left) / this.scale, (bottom - event.clientY + box.top) / this.scale];
  }

  robotAt(event, robots) {
    const [x, y] = this.placeOf(event);
    return robots.findIndex((r) => Math.hypot(r.x - x, r.y - y) < this.scenario.diameter_m / 2);
  }

  // The largest scale with which the board fits into its place and on the screen, and its origin.
  fit() {
    const [wide, high] = this.size, width = this.canvas.clientWidth;
    const across = MARGIN.left + MARGIN.right, down = MARGIN.top + MARGIN.bottom;
    this.scale = Math.min((width - across) / wide, (0.86 * window.innerHeight - down) / high);
    const height = Math.round(this.scale * high + down);
    if (this.canvas.clientHeight !== height) this.canvas.style.height = `${height}px`;
    this.origin = [MARGIN.left + (width - across - this.scale * wide) / 2, height - MARGIN.bottom];
  }

  draw(robots, { map, trails, selected, downhill }) {
    this.fit();
    const [g] = cleared(this.canvas), [wide, high] = this.size;
    this.g = g;
    g.save();
    g.translate(...this.origin);
    g.scale(this.scale, -this.scale);
    g.fillStyle = css("--board");
    g.fillRect(0, 0, wide, high);
    if (map) g.drawImage(this.mapOf(selected), 0, 0, wide, high);
    this.drawCells();
    this.drawScale();
    if (downhill !== null) this.drawSlope(downhill);
    if (trails) this.trails.forEach((trail, i) => this.line(trail, COLOURS[i], 1.5));
    robots.forEach((robot, i) => {
      if (robot.moving) this.line([[robot.x, robot.y], robot.goal], COLOURS[i], 2, [4, 4]);
    });
    robots.forEach((robot, i) => this.drawRobot(robot, i, i === selected));
    g.restore();
  }

  line(points, colour, width, dash = []) {
    const { g } = this;
    g.strokeStyle = colour;
    g.lineWidth = width / this.scale;
    g.setLineDash(dash.map((part) => part / this.scale));
    g.beginPath();
    points.forEach(([x, y], k) => (k ? g.lineTo(x, y) : g.moveTo(x, y)));
    g.stroke();
    g.setLineDash([]);
  }

  // Text at a place in m, moved by pixels.
  text(words, x, y, { by = [0, 0], align = "center", base = "middle", colour = css("--quiet"), font = 12 } = {}) {
    const { g } = this;
    g.save();
    g.translate(x, y);
    g.scale(1 / this.scale, -1 / this.scale);
    Object.assign(g, { fillStyle: colour, textAlign: align, textBaseline: base, font: font + FONT });
    g.fillText(words, ...by);
    g.restore();
  }

  arrow(g, x, y, angle, length, head) {
    const tip = [x + length * Math.cos(angle), y + length * Math.sin(angle)];
    g.moveTo(x, y);
    g.lineTo(...tip);
    for (const side of [-0.45, 0.45]) {
      g.moveTo(...tip);
      g.lineTo(tip[0] - head * Math.cos(angle + side), tip[1] - head * Math.sin(angle + side));
    }
  }

  // A robot's map as a picture, drawn again where robot, size or colours change; its rows go downwards.
  mapOf(robot) {
    const { columns, rows, cell_m, maps } = this.scenario;
    const size = this.scale * cell_m * (window.devicePixelRatio || 1), key = [robot, size, css("--quiet")].join();
    if (this.mapKey !== key) {
      this.picture ??= document.createElement("canvas");
      [this.picture.width, this.picture.height] = [Math.round(size * columns), Math.round(size * rows)];
      const g = this.picture.getContext("2d");
      g.scale(size, size);
      this.drawMap(g, maps[robot], size);
      this.mapKey = key;
    }
    return this.picture;
  }

  drawMap(g, map, size) {
    const { columns, rows } = this.scenario;
    const known = map.value.filter((v) => v !== null), low = Math.min(...known), high = Math.max(...known);
    g.strokeStyle = css("--quiet");
    g.lineWidth = 1 / size;
    g.beginPath();
    for (let x = 0; x < columns; x++)
      for (let y = 0; y < rows; y++) {
        const value = map.value[x * rows + y], angle = map.action[x * rows + y] * EIGHTH;
        if (value === null) continue;
        const near = (value - low) / (high - low || 1);
        g.fillStyle = `hsl(${215 + 150 * (1 - near)} 65% 50% / ${0.08 + 0.34 * near})`;
        g.fillRect(x, y, 1, 1);
        this.arrow(g, x + 0.5 - 0.36 * Math.cos(angle), y + 0.5 - 0.36 * Math.sin(angle), angle, 0.72, 0.3);
      }
    g.stroke();
  }

  drawCells() {
    const { g } = this, { cell_m: cell, targets, walls, zone, patches, edge } = this.scenario;
    for (const [left, bottom, right, top, mu] of patches) {
      g.fillStyle = css("--patch");
      g.fillRect(left, bottom, right - left, top - bottom);
      this.text(`µ ${mu}`, left, top, { by: [4, 4], align: "left", base: "top", font: 13 });
    }
    const [first, lowest, last, highest] = zone.map((at, k) => (at + (k > 1)) * cell);
    g.strokeStyle = css("--line");
    g.lineWidth = 1 / this.scale;
    g.strokeRect(first, lowest, last - first, highest - lowest);
    g.lineWidth = (edge ? 4 : 1) / this.scale; // a table's edge, which robots fall off
    g.strokeRect(0, 0, ...this.size);
    g.fillStyle = css("--quiet");
    for (const [left, bottom, right, top] of walls) g.fillRect(left, bottom, right - left, top - bottom);
    targets.forEach(([column, row], i) => {
      const [left, bottom, right, top] = [column, row, column + 1, row + 1].map((at) => at * cell);
      this.line([[left, bottom], [right, bottom], [right, top], [left, top], [left, bottom], [right, top]], COLOURS[i], 2);
      this.line([[left, top], [right, bottom]], COLOURS[i], 2);
      this.text(`${i + 1}`, right, top, { by: [3, -3], align: "left", base: "bottom", colour: COLOURS[i] });
    });
  }

  // Centimetres along the lower and the left edge.
  drawScale() {
    const [wide, high] = this.size, every = [1, 2, 5, 10, 20, 50, 100].find((cm) => 0.01 * cm * this.scale >= 45) ?? 200;
    for (let cm = 0; 0.01 * cm <= Math.max(wide, high) + 1e-9; cm += every) {
      const at = 0.01 * cm, tick = 4 / this.scale;
      if (at <= wide + 1e-9) this.line([[at, 0], [at, -tick]], css("--quiet"), 1);
      if (at <= wide + 1e-9) this.text(`${cm}`, at, 0, { by: [0, 7], base: "top" });
      if (at <= high + 1e-9) this.line([[0, at], [-tick, at]], css("--quiet"), 1);
      if (at <= high + 1e-9 && cm) this.text(`${cm}`, 0, at, { by: [-6, 0], align: "right" });
    }
    this.text("cm", wide, 0, { by: [0, 20], align: "right", base: "top" });
  }

  drawSlope(angle) {
    const [wide, high] = this.size, { g } = this, length = 34 / this.scale;
    g.beginPath();
    g.strokeStyle = css("--text");
    g.lineWidth = 2 / this.scale;
    this.arrow(g, wide - 1.6 * length, high - 1.2 * length, angle, length, 0.3 * length);
    g.stroke();
    this.text("downhill", wide, high, { by: [-6, 4], align: "right", base: "top" });
  }

  drawRobot(robot, i, selected) {
    const { g } = this, radius = this.scenario.diameter_m / 2, motor = 0.2 * radius;
    g.save();
    g.translate(robot.x, robot.y);
    g.rotate(robot.heading);
    g.fillStyle = g.strokeStyle = COLOURS[i];
    g.globalAlpha = 0.25;
    this.disc(0, 0, radius);
    g.fill();
    g.globalAlpha = 1;
    g.lineWidth = (selected ? 3 : 1.5) / this.scale;
    g.stroke();
    this.line([[0.6 * radius, 0], [radius, 0]], COLOURS[i], 3);
    g.fillStyle = css("--quiet");
    const foot = 0.12 * radius;
    for (const [, [x, y]] of this.machine.feet) g.fillRect(x - foot / 2, y - foot / 2, foot, foot);
    this.machine.motors.forEach(([, [x, y]], k) => {
      g.strokeStyle = css("--quiet");
      g.lineWidth = 1 / this.scale;
      this.disc(x, y, motor);
      g.stroke();
      g.fillStyle = COLOURS[i];
      this.disc(x - 0.65 * motor * Math.sin(robot.theta[k]), y - 0.65 * motor * Math.cos(robot.theta[k]), 0.45 * motor);
      g.fill();
    });
    g.restore();
    const named = radius * this.scale > 60; // whether there is room for the names of its parts
    const turned = ([x, y]) => {
      const [c, s] = [Math.cos(robot.heading), Math.sin(robot.heading)];
      return [robot.x + c * x - s * y, robot.y + s * x + c * y];
    };
    for (const [name, place] of named ? [...this.machine.motors, ...this.machine.feet] : [])
      this.text(name, ...turned(place), { by: [0.28 * radius * this.scale, 0], font: 11 });
    this.text(`${i + 1}`, robot.x, robot.y, { colour: css("--text"), font: "600 13" });
  }

  disc(x, y, radius) {
    this.g.beginPath();
    this.g.arc(x, y, radius, 0, 2 * Math.PI);
  }
}
