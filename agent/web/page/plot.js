// A plot of some signals over the last seconds.
const KEPT = 400; // points
const LEAST = 0.01; // smaller values are 0: in the unit, and as a share of the range
const VALUES = 46; // px on the left for values

// Three digits, as people read them.
const short = (value) => Number(value.toPrecision(3)).toString().replace("-", "−");

class Plot {
  constructor(canvas, caption, title, unit, names) {
    Object.assign(this, { canvas, title, unit, names });
    caption.replaceChildren(`${title} in ${unit}: `);
    names.forEach((name, k) => {
      const part = Object.assign(document.createElement("b"), { textContent: `${name} ` });
      part.style.color = COLOURS[k];
      caption.append(part);
    });
    this.clear();
  }

  clear() {
    this.points = [];
  }

  // Values of all robots.
  add(time, of) {
    this.points.push({ time, of });
    if (this.points.length > KEPT) this.points.shift();
  }

  draw(robot) {
    const [g, width, height] = cleared(this.canvas), all = this.points.flatMap((p) => p.of[robot]);
    let [low, high] = [Math.min(0, ...all), Math.max(0, ...all)];
    if (high - low < LEAST) [low, high] = [0, 1];
    [low, high] = [low, high].map((end) => (Math.abs(end) < LEAST * (high - low) ? 0 : end)); // of motors at rest
    const first = this.points[0]?.time ?? 0, last = Math.max(this.points.at(-1)?.time ?? 1, first + 1);
    const x = (time) => VALUES + ((time - first) / (last - first)) * (width - VALUES - 4);
    const y = (value) => 6 + ((high - value) / (high - low)) * (height - 24);
    Object.assign(g, { font: 12 + FONT, fillStyle: css("--quiet"), textAlign: "right", textBaseline: "middle" });
    const line = (colour, points) => {
      g.strokeStyle = colour;
      g.beginPath();
      points.forEach((point) => g.lineTo(...point));
      g.stroke();
    };
    for (const value of new Set([low, 0, high])) {
      if (value === 0 && [low, high].some((end) => end && Math.abs(y(end) - y(0)) < 14)) continue;
      g.fillText(short(value), VALUES - 5, y(value));
      line(css("--line"), [[VALUES, y(value)], [width - 4, y(value)]]);
    }
    g.textBaseline = "bottom";
    g.fillText(`${last.toFixed(1)} s`, width - 4, height);
    g.textAlign = "left";
    g.fillText(`${first.toFixed(1)} s`, VALUES, height);
    g.lineWidth = 1.3;
    this.names.forEach((_, k) => line(COLOURS[k], this.points.map((p) => [x(p.time), y(p.of[robot][k])])));
    const now = this.points.at(-1)?.of[robot].map((v, k) => `${this.names[k]} ${short(v)}`) ?? [];
    this.canvas.setAttribute("aria-label", `${this.title} in ${this.unit}: ${now.join(", ") || "nothing yet"}`);
  }
}
