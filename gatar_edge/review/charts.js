// Small charts over the mission's time, as SVG. With two runs, the second is dashed.

import { lastAt } from "gatar/run";

const W = 340, H = 132, PAD = { l: 34, r: 6, t: 8, b: 18 };
const NS = "http://www.w3.org/2000/svg";

const last = (rows, t, column) => rows[lastAt(rows, t)]?.[column] ?? null;
const sampled = (run, f, n = 160) => Array.from({ length: n + 1 }, (_, i) => { const t = (i / n) * run.duration; return [t, f(t)]; });
const cumulated = (rows, column, scale) => { let sum = 0; return rows.map((row) => [row[0], (sum += row[column] / scale)]); };

// Each chart: title, how to print a value, and its lines as [name, colour, points, drawn as steps].
export const CHARTS = [
  { title: "Targets localized", print: (v) => v.toFixed(0), top: (run) => run.reachable,
    lines: (run) => [["", "done", [[0, 0], ...run.visits.map((v, i) => [v[0], i + 1]), [run.duration, run.localized(run.duration)]], true]] },
  { title: "Distance, cells", print: (v) => v.toFixed(0),
    lines: (run) => [0, 1].filter((k) => run.robots.some((r) => r.kind === k)).map((k) => [["UAV", "UGV"][k], ["UAV", "UGV"][k], sampled(run, (t) => run.distance(k, t))]) },
  { title: "Radio, kB sent per robot", print: (v) => v.toFixed(1), lines: (run) => [["", "UAV", cumulated(run.radio, 2, 1000 * Math.max(1, run.robots.length))]] },
  { title: "Decision time, ms", print: (v) => v.toFixed(2), lines: (run) => [["p50", "UAV", run.latency.map((r) => [r[0], r[1]])], ["p99", "UGV", run.latency.map((r) => [r[0], r[2]])]] },
  { title: "Robots heard, mean", print: (v) => v.toFixed(1), lines: (run) => [["", "UAV", run.ages.map((r) => [r[0], r[3]])]] },
  { title: "Age of what was heard, s", print: (v) => v.toFixed(2), lines: (run) => [["p50", "UAV", run.ages.map((r) => [r[0], r[1]])], ["p99", "UGV", run.ages.map((r) => [r[0], r[2]])]] },
];

export class Chart {
  constructor(chart, runs, parent, seek) {
    this.chart = chart; this.runs = runs; this.duration = Math.max(...runs.map((r) => r.duration));
    this.root = parent.appendChild(Object.assign(document.createElement("figure"), { className: "chart" }));
    this.root.style.margin = 0;
    this.root.innerHTML = `<div class="chart-head"><h2>${chart.title}</h2><div class="now"></div></div>`;
    this.now = this.root.querySelector(".now");
    this.lines = runs.flatMap((run, i) => chart.lines(run).map(([name, color, points, steps]) => ({ name, color, points, steps, run: i })));
    const peak = Math.max(...this.lines.flatMap((l) => l.points.map((p) => p[1])), ...runs.map((r) => chart.top?.(r) ?? 0));
    this.top = nice(Number.isFinite(peak) && peak > 0 ? peak : 1);
    this.svg = this.root.appendChild(el("svg", { viewBox: `0 0 ${W} ${H}`, preserveAspectRatio: "none", role: "img", "aria-label": this.label() }));
    this.paint();
    const at = (event) => { const box = this.svg.getBoundingClientRect(); seek(((event.clientX - box.left) / box.width * W - PAD.l) / (W - PAD.l - PAD.r) * this.duration); };
    this.svg.addEventListener("pointerdown", at);
    this.svg.addEventListener("pointermove", (event) => { if (event.buttons) at(event); });
  }

  x(t) { return PAD.l + (t / this.duration) * (W - PAD.l - PAD.r); }
  y(v) { return H - PAD.b - (v / this.top) * (H - PAD.t - PAD.b); }

  label() {
    const ends = this.lines.map((l) => `${l.name} ends at ${l.points.length ? this.chart.print(l.points.at(-1)[1]) : "nothing"}`);
    return `${this.chart.title}: ${ends.join(", ")}, highest ${this.chart.print(this.top)}`;
  }

  paint() {
    for (const part of [0, 0.5, 1]) {
      const y = this.y(this.top * part);
      this.svg.append(el("line", { x1: PAD.l, x2: W - PAD.r, y1: y, y2: y, stroke: "var(--line)", "vector-effect": "non-scaling-stroke" }));
    }
    for (const line of this.lines) this.line(line);
    this.cursor = el("line", { y1: PAD.t - 4, y2: H - PAD.b, stroke: "var(--ink)", "vector-effect": "non-scaling-stroke", "stroke-width": 1.2 });
    this.svg.append(this.cursor);
    const box = this.root.appendChild(document.createElement("div"));
    box.style.cssText = "display:flex;justify-content:space-between;color:var(--muted);font-size:11px;margin-top:-14px;padding-left:9%";
    box.innerHTML = `<span>0</span><span>${this.runs[0].label(this.duration)}</span>`;
    const scale = this.root.appendChild(document.createElement("div"));
    scale.style.cssText = "position:absolute;inset:auto auto auto 14px;color:var(--muted);font-size:11px;pointer-events:none;display:flex;flex-direction:column;justify-content:space-between;height:112px;margin-top:-136px";
    scale.innerHTML = [1, 0.5, 0].map((part) => `<span style="line-height:1">${short(this.top * part)}</span>`).join("");
    this.root.style.position = "relative";
  }

  line({ points, color, steps, run }) {
    if (!points.length) return;
    let d = "", area = `M${this.x(points[0][0])} ${this.y(0)}`, py = 0;
    points.forEach(([t, v], i) => {
      const x = this.x(t).toFixed(1), y = this.y(v).toFixed(1);
      const move = i === 0 ? `M${x} ${y}` : steps ? `H${x}V${y}` : `L${x} ${y}`;
      d += move; area += i === 0 ? `L${x} ${y}` : move; py = y;
    });
    area += `L${this.x(points.at(-1)[0])} ${this.y(0)}Z`;
    const dash = run ? { "stroke-dasharray": "4 4" } : {};
    if (!run && this.lines.length === this.runs.length) this.svg.append(el("path", { d: area, fill: `var(--${color.toLowerCase()})`, opacity: 0.1 }));
    this.svg.append(el("path", { d, fill: "none", stroke: `var(--${color.toLowerCase()})`, "stroke-width": 1.8, "stroke-linejoin": "round", "vector-effect": "non-scaling-stroke", ...dash }));
  }

  draw(t) {
    const x = this.x(t).toFixed(2);
    this.cursor.setAttribute("x1", x); this.cursor.setAttribute("x2", x);
    const value = (l) => { const v = last(l.points, t, 1); return v === null ? "–" : this.chart.print(v); };
    const text = this.lines.filter((l) => !l.run).map((l) => {
      const rival = this.lines.find((m) => m.run && m.name === l.name);
      return `<span style="color:var(--${l.color.toLowerCase()})">${l.name} ${value(l)}${rival ? ` / ${value(rival)}` : ""}</span>`;
    }).join("");
    if (text !== this.text) this.now.innerHTML = this.text = text;
  }
}

function el(name, attributes) {
  const node = document.createElementNS(NS, name);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  return node;
}

function nice(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  return [1, 1.2, 1.6, 2, 2.5, 3, 4, 5, 6, 8, 10].map((m) => m * power).find((m) => m >= value) ?? value;
}

function short(value) { return value >= 10000 ? `${value / 1000}k` : +value.toPrecision(3); }
