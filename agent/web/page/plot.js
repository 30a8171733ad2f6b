// A plot of some signals over the last seconds.
const KEPT = 400; // points
const VALUES = 46; // px on the left for values

// Three digits, as people read them.
const short = (value) => Number(value.toPrecision(3)).toString().replace("-", "−");

class Plot {
  constructor(canvas, caption, title, unit, names) {
    Object.assign(this, { canvas, title, unit, names });
    caption.replaceChildren(`${title} in ${unit}: `);
    names.forEach((name, k) => {
      const part = document.createElement("b");
      part.textContent = `${name} `;
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
    const [g, width, height] = cleared(this.canvas);
    const all = this.points.flatMap((p) => p.of[robot]);
    let low = Math.min(0, ...all), high = Math.max(0, ...all);
    if (low === high) high = low + 1;
    const times = this.points.map((p) => p.time), first = times[0] ?? 0, last = Math.max(times.at(-1) ?? 1, first + 1);
    const x = (time) => VALUES + ((time - first) / (last - first)) * (width - VALUES - 4);
    const y = (value) => 6 + ((high - value) / (high - low)) * (height - 24);
    Object.assign(g, { font: 12 + FONT, fillStyle: css("--quiet"), strokeStyle: css("--line"), textAlign: "right", textBaseline: "middle" });
    for (const value of new Set([low, 0, high])) {
      if (value === 0 && ((y(low) - y(0) < 14 && low !== 0) || (y(0) - y(high) < 14 && high !== 0))) continue;
      g.fillText(short(value), VALUES - 5, y(value));
      g.beginPath();
      g.moveTo(VALUES, y(value));
      g.lineTo(width - 4, y(value));
      g.stroke();
    }
    g.textBaseline = "bottom";
    g.fillText(`${last.toFixed(1)} s`, width - 4, height);
    g.textAlign = "left";
    g.fillText(`${first.toFixed(1)} s`, VALUES, height);
    g.lineWidth = 1.3;
    this.names.forEach((_, k) => {
      g.strokeStyle = COLOURS[k];
      g.beginPath();
      this.points.forEach((p, n) => g[n ? "lineTo" : "moveTo"](x(p.time), y(p.of[robot][k])));
      g.stroke();
    });
    const now = this.points.at(-1)?.of[robot].map((v, k) => `${this.names[k]} ${short(v)}`) ?? [];
    this.canvas.setAttribute("aria-label", `${this.title} in ${this.unit}: ${now.join(", ") || "nothing yet"}`);
  }
}
