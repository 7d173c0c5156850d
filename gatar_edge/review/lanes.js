// Who did what when: one lane a robot. And the marks under the scrubber.

import { KIND, TASK, lastAt, taskText } from "gatar/run";

const LEFT = 62, ROW = 26, AXIS = 20;

export class Lanes {
  constructor(run, parent, options) {
    Object.assign(this, { run, parent, options });
    this.canvas = document.createElement("canvas");
    this.canvas.setAttribute("role", "img");
    this.tip = Object.assign(document.createElement("div"), { className: "tip", hidden: true });
    parent.append(this.canvas, this.tip);
    new ResizeObserver(() => this.resize()).observe(parent);
    this.canvas.addEventListener("pointermove", (event) => this.hover(event));
    this.canvas.addEventListener("pointerleave", () => { this.tip.hidden = true; });
    this.canvas.addEventListener("pointerdown", (event) => this.press(event));
    const total = run.robots.length;
    this.canvas.setAttribute("aria-label", `Time line of the tasks of ${total} robots; the decisions table below holds the same.`);
    this.resize();
  }

  resize() {
    this.width = this.parent.clientWidth;
    this.row = this.run.robots.length > 14 ? 18 : ROW;
    this.height = this.run.robots.length * this.row + AXIS;
    const ratio = window.devicePixelRatio || 1;
    for (const canvas of [this.canvas, (this.still = document.createElement("canvas"))]) {
      canvas.width = this.width * ratio; canvas.height = this.height * ratio;
    }
    this.canvas.style.height = `${this.height}px`;
    this.ratio = ratio; this.drawn = null;
    this.options.resized();
  }

  x(t) { return LEFT + (t / this.run.span) * (this.width - LEFT - 8); }
  t(x) { return Math.max(0, Math.min(1, (x - LEFT) / (this.width - LEFT - 8))) * this.run.span; }

  draw(t, state) {
    const key = state.theme + state.follow + this.run.span;
    if (this.drawn !== key) { this.paint(state); this.drawn = key; }
    const ctx = this.canvas.getContext("2d");
    ctx.setTransform(1, 0, 0, 1, 0, 0); ctx.clearRect(0, 0, this.canvas.width, this.canvas.height);
    ctx.drawImage(this.still, 0, 0);
    ctx.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    ctx.fillStyle = state.colors.surface; ctx.globalAlpha = 0.5;
    ctx.fillRect(this.x(t), 0, this.width - this.x(t), this.height - AXIS); ctx.globalAlpha = 1;
    ctx.strokeStyle = state.colors.ink; ctx.lineWidth = 1.5;
    ctx.beginPath(); ctx.moveTo(this.x(t), 0); ctx.lineTo(this.x(t), this.height - AXIS + 4); ctx.stroke();
  }

  paint(state) {
    const ctx = this.still.getContext("2d");
    ctx.setTransform(this.ratio, 0, 0, this.ratio, 0, 0); ctx.clearRect(0, 0, this.width, this.height);
    this.run.robots.forEach((robot, index) => this.lane(ctx, robot, index * this.row, state));
    this.axis(ctx, state.colors);
  }

  lane(ctx, robot, top, { colors, follow }) {
    const color = colors[KIND[robot.kind]], middle = top + this.row / 2, faded = follow && follow !== robot.id ? 0.35 : 1;
    ctx.globalAlpha = faded; ctx.fillStyle = colors.ink; ctx.textBaseline = "middle"; ctx.textAlign = "left";
    ctx.font = `${follow === robot.id ? 650 : 450} 12.5px system-ui, sans-serif`;
    ctx.fillText(`${KIND[robot.kind]} ${robot.id}`, 2, middle);
    ctx.strokeStyle = colors.line; ctx.lineWidth = 1; ctx.beginPath(); ctx.moveTo(LEFT, middle); ctx.lineTo(this.width - 8, middle); ctx.stroke();
    robot.tasks.forEach((task, i) => {
      const from = this.x(task[0]), to = this.x(robot.tasks[i + 1]?.[0] ?? this.run.duration), wide = Math.max(1, to - from - 1.5);
      if (task[1] === TASK.TARGET) {
        ctx.fillStyle = color; ctx.globalAlpha = 0.88 * faded; bar(ctx, from, middle - this.row * 0.32, wide, this.row * 0.64);
      } else if (task[1] === TASK.EXPLORE) {
        ctx.fillStyle = color; ctx.globalAlpha = 0.26 * faded; bar(ctx, from, middle - this.row * 0.19, wide, this.row * 0.38);
      }
      const event = this.run.events[task[4]];
      if (event?.retask) { ctx.globalAlpha = faded; ctx.fillStyle = colors.target; ctx.beginPath(); ctx.arc(from, top + 4.5, 2.6, 0, 7); ctx.fill(); }
    });
    ctx.globalAlpha = faded; ctx.fillStyle = colors.done; ctx.strokeStyle = colors.surface; ctx.lineWidth = 1.5;
    for (const [at, id] of this.run.visits) {
      if (id !== robot.id) continue;
      ctx.beginPath(); ctx.arc(this.x(at), middle, Math.min(5, this.row * 0.2), 0, 7); ctx.fill(); ctx.stroke();
    }
    ctx.globalAlpha = 1;
  }

  axis(ctx, colors) {
    const seconds = this.run.span / 1000, most = Math.max(2, (this.width - LEFT) / 86);
    const every = [0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600].find((n) => seconds / n <= most) ?? 7200;
    ctx.fillStyle = colors.muted; ctx.font = "11px system-ui, sans-serif"; ctx.textAlign = "center"; ctx.textBaseline = "alphabetic";
    for (let s = 0; s <= seconds; s += every) ctx.fillText(every >= 60 ? `${s / 60} min` : `${s} s`, Math.min(this.width - 16, this.x(s * 1000)), this.height - 4);
  }

  at(event) {
    const box = this.canvas.getBoundingClientRect(), index = Math.floor((event.clientY - box.top) / this.row);
    return { t: this.t(event.clientX - box.left), robot: this.run.robots[index], x: event.clientX - box.left, y: index * this.row };
  }

  hover(event) {
    const { t, robot, x, y } = this.at(event);
    if (event.buttons) this.options.seek(t);
    const task = robot && robot.tasks[lastAt(robot.tasks, t)];
    this.tip.hidden = !task;
    if (!task) return;
    this.tip.textContent = `${this.run.label(t)}  ${KIND[robot.kind]} ${robot.id}: ${taskText(task)}`;
    this.tip.style.left = `${Math.max(110, Math.min(this.width - 110, x))}px`; this.tip.style.top = `${y - 2}px`;
  }

  press(event) {
    const { t, robot, x } = this.at(event);
    if (x < LEFT && robot) this.options.pick(robot.id); else this.options.seek(t);
  }
}

function bar(ctx, x, y, wide, high) { ctx.beginPath(); ctx.roundRect(x, y, wide, high, Math.min(4, wide / 2)); ctx.fill(); }

// Progress and visits under the scrubber's thumb.
export function scrubMarks(canvas, run, t, colors) {
  const ratio = window.devicePixelRatio || 1, wide = canvas.clientWidth, high = canvas.clientHeight, r = 8;
  canvas.width = wide * ratio; canvas.height = high * ratio;
  const ctx = canvas.getContext("2d"), x = (at) => r + (at / run.span) * (wide - 2 * r), y = high / 2;
  ctx.scale(ratio, ratio);
  ctx.fillStyle = colors.line; bar(ctx, r, y - 2.5, wide - 2 * r, 5);
  ctx.fillStyle = colors.ink; bar(ctx, r, y - 2.5, Math.max(2, x(t) - r), 5);
  ctx.fillStyle = colors.done;
  for (const [at] of run.visits) { ctx.beginPath(); ctx.arc(x(at), y - 8.5, 2, 0, 7); ctx.fill(); }
  ctx.fillStyle = colors.bad;
  for (const [at] of run.faults) { ctx.beginPath(); ctx.arc(x(at), y + 8.5, 2, 0, 7); ctx.fill(); }
}
