// The top view: board, value map, trails, moves and robots.
const COLOURS = ["#1f83d6", "#d55e00", "#009e73", "#cc79a7", "#b8860b", "#56b4e9", "#8c564b", "#7f7f7f",
  "#5e3c99", "#3a7d00", "#e7298a", "#008b8b", "#a6761d", "#6a5acd", "#c23b22", "#4a6fa5"];
const EIGHTH = Math.PI / 4, FONT = "px system-ui, sans-serif";
const MOTOR = 0.2; // radius of a motor over that of the robot
const MARGINS = [26, 10, 10, 34]; // left, right, top, bottom, for the scale of the board, px

const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

// A canvas with as many pixels as its place on the screen has, cleared, in CSS pixels.
function cleared(canvas) {
  const { clientWidth: width, clientHeight: height } = canvas, ratio = window.devicePixelRatio || 1;
  const size = [width, height].map((length) => Math.round(length * ratio)), g = canvas.getContext("2d");
  if (canvas.width !== size[0] || canvas.height !== size[1]) [canvas.width, canvas.height] = size;
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
      const last = this.trails[i].at(-1);
      if (!last || Math.hypot(x - last[0], y - last[1]) > 5e-4) this.trails[i].push([x, y]);
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
    const [wide, high] = this.size, width = this.canvas.clientWidth, { diameter_m } = this.scenario;
    const parts = [...this.machine.motors, ...this.machine.feet].map(([, place]) => Math.hypot(...place) + MOTOR * diameter_m / 2);
    const reach = Math.max(diameter_m / 2, ...parts); // of a robot on the edge, with all its parts
    const out = (width / (wide + 2 * reach)) * reach + 2; // px
    const [left, right, top, bottom] = MARGINS.map((least) => Math.max(least, out));
    this.scale = Math.min((width - left - right) / wide, (0.86 * window.innerHeight - top - bottom) / high);
    const height = Math.round(this.scale * high + top + bottom);
    if (this.canvas.clientHeight !== height) this.canvas.style.height = `${height}px`;
    this.origin = [left + (width - left - right - this.scale * wide) / 2, height - bottom];
  }

  draw(robots, { map, trails, selected, downhill, dragged }) {
    this.fit();
    const [g] = cleared(this.canvas);
    this.g = g;
    g.save();
    g.translate(...this.origin);
    g.scale(this.scale, -this.scale);
    g.fillStyle = css("--board");
    g.fillRect(0, 0, ...this.size);
    if (map) g.drawImage(this.mapOf(selected), 0, 0, ...this.size);
    this.drawCells();
    this.drawScale();
    if (downhill !== null) this.drawSlope(downhill);
    if (trails) this.trails.forEach((trail, i) => this.line(trail, COLOURS[i], 1.5));
    robots.forEach(({ moving, x, y, goal }, i) => moving && this.line([[x, y], goal], COLOURS[i], 2, [4, 4]));
    robots.forEach((robot, i) => this.drawRobot(robot, i, i === selected));
    if (dragged?.to) this.drawGhost(dragged);
    g.restore();
  }

  line(points, colour, width, dash = []) {
    const { g } = this;
    Object.assign(g, { strokeStyle: colour, lineWidth: width / this.scale });
    g.setLineDash(dash.map((part) => part / this.scale));
    g.beginPath();
    points.forEach((point) => g.lineTo(...point));
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

  // The path of an arrow from a point on.
  arrow(g, x, y, angle, length, head) {
    const tip = [x + length * Math.cos(angle), y + length * Math.sin(angle)];
    g.moveTo(x, y);
    for (const side of [-0.45, 0.45]) {
      g.lineTo(...tip);
      g.lineTo(tip[0] - head * Math.cos(angle + side), tip[1] - head * Math.sin(angle + side));
      g.moveTo(...tip);
    }
  }

  // A robot's map as a picture, drawn again where robot, size or colours change; its rows go downwards.
  mapOf(robot) {
    const { columns, rows, cell_m, maps } = this.scenario;
    const size = this.scale * cell_m * (window.devicePixelRatio || 1), key = [robot, size, css("--quiet")].join();
    if (this.mapKey !== key) {
      this.picture ??= document.createElement("canvas");
      [this.picture.width, this.picture.height] = [Math.round(size * columns), Math.round(size * rows)];
      this.drawMap(this.picture.getContext("2d"), maps[robot], size);
      this.mapKey = key;
    }
    return this.picture;
  }

  drawMap(g, { value: values, action }, size) {
    const known = values.filter((v) => v !== null), low = Math.min(...known), high = Math.max(...known);
    g.scale(size, size);
    Object.assign(g, { strokeStyle: css("--quiet"), lineWidth: 1 / size });
    g.beginPath();
    values.forEach((value, cell) => {
      if (value === null) return;
      const x = Math.floor(cell / this.scenario.rows), y = cell % this.scenario.rows, angle = action[cell] * EIGHTH;
      const near = (value - low) / (high - low || 1);
      g.fillStyle = `hsl(${215 + 150 * (1 - near)} 65% 50% / ${0.08 + 0.34 * near})`;
      g.fillRect(x, y, 1, 1);
      this.arrow(g, x + 0.5 - 0.36 * Math.cos(angle), y + 0.5 - 0.36 * Math.sin(angle), angle, 0.72, 0.3);
    });
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
    Object.assign(g, { strokeStyle: css("--line"), lineWidth: 1 / this.scale });
    g.strokeRect(first, lowest, last - first, highest - lowest);
    g.lineWidth = (edge ? 4 : 1) / this.scale; // a table's edge, which robots fall off
    g.strokeRect(0, 0, ...this.size);
    g.fillStyle = css("--quiet");
    for (const [left, bottom, right, top] of walls) g.fillRect(left, bottom, right - left, top - bottom);
    targets.forEach(([column, row], i) => {
      const [left, bottom, right, top] = [column, row, column + 1, row + 1].map((at) => at * cell);
      const around = [[left, top], [left, bottom], [right, bottom], [right, top], [left, top]];
      this.line([...around, [right, bottom]], COLOURS[i], 2);
      this.line([[left, bottom], [right, top]], COLOURS[i], 2);
      this.text(`${i + 1}`, right, top, { by: [3, -3], align: "left", base: "bottom", colour: COLOURS[i] });
    });
  }

  // Centimetres along the lower and the left edge.
  drawScale() {
    const steps = [1, 2, 5, 10, 20, 50, 100], every = steps.find((cm) => 0.01 * cm * this.scale >= 60) ?? 200;
    this.size.forEach((length, axis) => {
      for (let cm = 0; 0.01 * cm <= length + 1e-9; cm += every) {
        const along = (off) => (axis ? [off, 0.01 * cm] : [0.01 * cm, off]);
        this.line([along(0), along(-4 / this.scale)], css("--quiet"), 1);
        const side = axis ? { by: [-6, 0], align: "right" } : { by: [0, 7], base: "top" };
        if (cm || !axis) this.text(`${cm}`, ...along(0), side);
      }
    });
    this.text("cm", this.size[0], 0, { by: [0, 20], align: "right", base: "top" });
  }

  drawSlope(angle) {
    const [wide, high] = this.size, { g } = this, length = 34 / this.scale;
    Object.assign(g, { strokeStyle: css("--text"), lineWidth: 2 / this.scale });
    g.beginPath();
    this.arrow(g, wide - 1.6 * length, high - 1.6 * length, angle, length, 0.3 * length);
    g.stroke();
    this.text("downhill", wide, high, { by: [-6, 4], align: "right", base: "top" });
  }

  // Where a robot would be put.
  drawGhost({ robot, to }) {
    Object.assign(this.g, { strokeStyle: COLOURS[robot], lineWidth: 2 / this.scale });
    this.g.setLineDash([6 / this.scale]);
    this.disc(...to, this.scenario.diameter_m / 2, "stroke");
    this.g.setLineDash([]);
  }

  drawRobot({ x, y, heading, theta, bent }, i, selected) {
    const { g } = this, { motors, feet, legs, enlarged } = this.machine, radius = this.scenario.diameter_m / 2;
    const motor = MOTOR * radius, foot = 0.12 * radius;
    g.save();
    g.translate(x, y);
    g.rotate(heading);
    Object.assign(g, { fillStyle: COLOURS[i], strokeStyle: COLOURS[i], lineWidth: (selected ? 3 : 1.5) / this.scale });
    g.globalAlpha = 0.25;
    this.disc(0, 0, radius, "fill");
    g.globalAlpha = 1;
    this.disc(0, 0, radius, "stroke");
    this.line([[0.6 * radius, 0], [radius, 0]], COLOURS[i], 3);
    Object.assign(g, { fillStyle: css("--quiet"), strokeStyle: css("--quiet"), lineWidth: 1 / this.scale });
    for (const [, place] of feet) g.fillRect(place[0] - foot / 2, place[1] - foot / 2, foot, foot);
    legs.forEach((root, k) => {
      const [u, v] = feet[k][1], tip = [0, 1].map((axis) => feet[k][1][axis] + enlarged * bent[3 * k + axis]);
      this.line([[u + root[0], v + root[1]], tip], css("--quiet"), 2);
    });
    for (const [, place] of motors) this.disc(...place, motor, "stroke");
    g.fillStyle = COLOURS[i];
    motors.forEach(([, place, hanging, later], k) => {
      const [c, s] = [Math.cos(theta[k]), Math.sin(theta[k])], at = hanging.map((part, axis) => c * part + s * later[axis]);
      g.globalAlpha = at[2] < 0 ? 0.5 : 1; // below the shaft
      this.disc(place[0] + 0.65 * motor * at[0], place[1] + 0.65 * motor * at[1], 0.45 * motor, "fill");
    });
    g.restore();
    this.text(`${i + 1}`, x, y, { colour: css("--text"), font: "600 13" });
    if (radius * this.scale < 50) return; // no room for the names of its parts
    const c = 0.68 * Math.cos(heading), s = 0.68 * Math.sin(heading);
    for (const [name, [u, v]] of [...motors, ...feet]) this.text(name, x + c * u - s * v, y + s * u + c * v, { font: 11 });
  }

  disc(x, y, radius, how) {
    this.g.beginPath();
    this.g.arc(x, y, radius, 0, 2 * Math.PI);
    this.g[how]();
  }
}
