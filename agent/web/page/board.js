// The top view: board, value map, trails, moves and robots.
const COLOURS = ["#1f83d6", "#d55e00", "#009e73", "#cc79a7", "#b8860b", "#56b4e9", "#8c564b", "#7f7f7f"];
const EIGHTH = Math.PI / 4;
const FACE = 0.42; // of a cell: length of a map's direction lines

const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

// A canvas with as many pixels as its place on the screen has, cleared, in CSS pixels.
function cleared(canvas, height) {
  const width = canvas.clientWidth, ratio = window.devicePixelRatio || 1;
  const size = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== size[0] || canvas.height !== size[1]) [canvas.width, canvas.height] = size;
  const g = canvas.getContext("2d");
  g.setTransform(ratio, 0, 0, ratio, 0, 0);
  g.clearRect(0, 0, width, height);
  return [g, width, height];
}

class Board {
  constructor(canvas, scenario) {
    this.canvas = canvas;
    this.scenario = scenario;
    canvas.style.aspectRatio = `${scenario.columns} / ${scenario.rows}`;
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
    const box = this.canvas.getBoundingClientRect();
    return [(event.clientX - box.left) / this.scale, this.rows_m - (event.clientY - box.top) / this.scale];
  }

  robotAt(event, robots) {
    const [x, y] = this.placeOf(event);
    return robots.findIndex((r) => Math.hypot(r.x - x, r.y - y) < this.scenario.diameter_m / 2);
  }

  draw(robots, options) {
    const { scenario } = this, height = this.canvas.clientHeight;
    const [g, width] = cleared(this.canvas, height);
    this.rows_m = scenario.rows * scenario.cell_m;
    this.scale = Math.min(width / (scenario.columns * scenario.cell_m), height / this.rows_m);
    g.save();
    g.fillStyle = css("--board");
    g.fillRect(0, 0, width, height);
    g.scale(this.scale, -this.scale);
    g.translate(0, -this.rows_m);
    if (options.map) g.drawImage(this.mapOf(options.selected, width), 0, 0, scenario.columns * scenario.cell_m, this.rows_m);
    this.drawCells(g);
    if (options.trails) this.trails.forEach((trail, i) => this.line(g, trail, COLOURS[i], 1.5));
    robots.forEach((robot, i) => this.drawMove(g, robot, COLOURS[i]));
    robots.forEach((robot, i) => this.drawRobot(g, robot, i, i === options.selected));
    g.restore();
  }

  line(g, points, colour, width, dash = []) {
    g.strokeStyle = colour;
    g.lineWidth = width / this.scale;
    g.setLineDash(dash.map((part) => part / this.scale));
    g.beginPath();
    points.forEach(([x, y], k) => (k ? g.lineTo(x, y) : g.moveTo(x, y)));
    g.stroke();
    g.setLineDash([]);
  }

  // A robot's map as a picture, drawn again where robot, size or colours change; its rows go downwards.
  mapOf(robot, width) {
    const key = [robot, width, css("--quiet")].join();
    if (this.mapKey !== key) {
      const { columns, rows } = this.scenario, size = (width * (window.devicePixelRatio || 1)) / columns;
      this.picture ??= document.createElement("canvas");
      [this.picture.width, this.picture.height] = [Math.round(size * columns), Math.round(size * rows)];
      const g = this.picture.getContext("2d");
      g.scale(size, size);
      this.drawMap(g, this.scenario.maps[robot], size);
      this.mapKey = key;
    }
    return this.picture;
  }

  drawMap(g, map, size) {
    const { columns, rows } = this.scenario;
    const known = map.value.filter((v) => v !== null), low = Math.min(...known), high = Math.max(...known);
    g.strokeStyle = css("--quiet");
    g.lineWidth = 0.8 / size;
    g.beginPath();
    for (let x = 0; x < columns; x++)
      for (let y = 0; y < rows; y++) {
        const value = map.value[x * rows + y];
        if (value === null) continue;
        const near = (value - low) / (high - low || 1);
        g.fillStyle = `hsl(${215 + 150 * (1 - near)} 65% 50% / ${0.08 + 0.34 * near})`;
        g.fillRect(x, y, 1, 1);
        const angle = map.action[x * rows + y] * EIGHTH;
        g.moveTo(x + 0.5, y + 0.5);
        g.lineTo(x + 0.5 + FACE * Math.cos(angle), y + 0.5 + FACE * Math.sin(angle));
      }
    g.stroke();
  }

  drawCells(g) {
    const { columns, rows, cell_m: cell, targets, walls, zone } = this.scenario;
    g.font = "14px system-ui, sans-serif";
    for (const [left, bottom, right, top, mu] of this.scenario.patches ?? []) {
      g.fillStyle = css("--patch");
      g.fillRect(left, bottom, right - left, top - bottom);
      g.save();
      g.translate(left, top);
      g.scale(1 / this.scale, -1 / this.scale);
      g.fillStyle = css("--quiet");
      g.fillText(`µ ${mu}`, 4, 16);
      g.restore();
    }
    g.strokeStyle = css("--line");
    g.lineWidth = 1 / this.scale;
    g.strokeRect(zone[0] * cell, zone[1] * cell, (zone[2] - zone[0] + 1) * cell, (zone[3] - zone[1] + 1) * cell);
    g.strokeRect(0, 0, columns * cell, rows * cell);
    g.fillStyle = css("--quiet");
    for (const [left, bottom, right, top] of walls) g.fillRect(left, bottom, right - left, top - bottom);
    targets.forEach(([x, y], i) => {
      g.strokeStyle = COLOURS[i];
      g.lineWidth = 2 / this.scale;
      g.strokeRect(x * cell, y * cell, cell, cell);
      this.line(g, [[x * cell, y * cell], [(x + 1) * cell, (y + 1) * cell]], COLOURS[i], 2);
      this.line(g, [[(x + 1) * cell, y * cell], [x * cell, (y + 1) * cell]], COLOURS[i], 2);
    });
  }

  drawMove(g, robot, colour) {
    if (robot.mode && !robot.arrived) this.line(g, [[robot.x, robot.y], robot.goal], colour, 2, [4, 4]);
  }

  drawRobot(g, robot, i, selected) {
    const radius = this.scenario.diameter_m / 2, motor = 0.2 * radius;
    g.save();
    g.translate(robot.x, robot.y);
    g.rotate(robot.heading);
    g.fillStyle = COLOURS[i];
    g.globalAlpha = 0.25;
    this.disc(g, 0, 0, radius);
    g.fill();
    g.globalAlpha = 1;
    g.lineWidth = (selected ? 3 : 1.5) / this.scale;
    g.strokeStyle = COLOURS[i];
    g.stroke();
    this.line(g, [[0.55 * radius, 0], [radius, 0]], COLOURS[i], 3);
    robot.theta.forEach((theta, k) => {
      const y = (k ? -0.55 : 0.55) * radius, mass = 0.65 * motor;
      g.strokeStyle = css("--quiet");
      g.lineWidth = 1 / this.scale;
      this.disc(g, 0, y, motor);
      g.stroke();
      g.fillStyle = COLOURS[i];
      this.disc(g, -mass * Math.sin(theta), y - mass * Math.cos(theta), 0.45 * motor);
      g.fill();
    });
    g.restore();
    g.save();
    g.translate(robot.x, robot.y);
    g.scale(1 / this.scale, -1 / this.scale);
    g.fillStyle = css("--text");
    g.font = "600 12px system-ui, sans-serif";
    g.textAlign = "center";
    g.textBaseline = "middle";
    g.fillText(`r${i + 1}`, 0, 0);
    g.restore();
  }

  disc(g, x, y, radius) {
    g.beginPath();
    g.arc(x, y, radius, 0, 2 * Math.PI);
  }
}
