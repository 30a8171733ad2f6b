// A plot of some signals over the last seconds.
const KEPT = 400; // points
const MARGIN = 46; // of the values on the left, px

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
    if (this.points.length && time <= this.points.at(-1).time) return;
    this.points.push({ time, of });
    if (this.points.length > KEPT) this.points.shift();
  }

  draw(robot) {
    const [g, width, height] = cleared(this.canvas, this.canvas.clientHeight);
    const all = this.points.flatMap((p) => p.of[robot]);
    let low = Math.min(0, ...all), high = Math.max(0, ...all);
    if (low === high) high = low + 1;
    const times = this.points.map((p) => p.time), first = times[0] ?? 0, last = Math.max(times.at(-1) ?? 1, first + 1);
    const x = (time) => MARGIN + ((time - first) / (last - first)) * (width - MARGIN - 4);
    const y = (value) => 6 + ((high - value) / (high - low)) * (height - 24);
    g.font = "12px system-ui, sans-serif";
    g.fillStyle = css("--quiet");
    g.strokeStyle = css("--line");
    g.textAlign = "right";
    g.textBaseline = "middle";
    for (const value of new Set([low, 0, high])) {
      if (value === 0 && (y(low) - y(0) < 14 && low !== 0 || y(0) - y(high) < 14 && high !== 0)) continue;
      g.fillText(short(value), MARGIN - 5, y(value));
      g.beginPath();
      g.moveTo(MARGIN, y(value));
      g.lineTo(width - 4, y(value));
      g.stroke();
    }
    g.textBaseline = "bottom";
    g.fillText(`${last.toFixed(1)} s`, width - 4, height);
    g.textAlign = "left";
    g.fillText(`${first.toFixed(1)} s`, MARGIN, height);
    this.names.forEach((_, k) => {
      g.strokeStyle = COLOURS[k];
      g.lineWidth = 1.3;
      g.beginPath();
      this.points.forEach((p, n) => (n ? g.lineTo(x(p.time), y(p.of[robot][k])) : g.moveTo(x(p.time), y(p.of[robot][k]))));
      g.stroke();
    });
    const now = this.points.at(-1)?.of[robot].map((v, k) => `${this.names[k]} ${short(v)}`) ?? [];
    this.canvas.setAttribute("aria-label", `${this.title} in ${this.unit}: ${now.join(", ") || "nothing yet"}`);
  }
}
