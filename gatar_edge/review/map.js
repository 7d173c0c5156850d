// The map: what the team or one robot knows, where everybody is, goes and hears. One canvas, drawn anew each frame.

import { BeliefPlayer, CELL, KIND, TASK } from "gatar/run";

const MARGIN = 10, AXES = 26; // pixels: the axes are on the left and below
const FOLLOW_CELLS = 31; // a larger world is shown in part when one robot is followed

export class MapView {
  constructor(run, frame, options) {
    this.run = run;
    this.options = options;
    this.canvas = document.createElement("canvas");
    this.canvas.setAttribute("role", "img");
    frame.append(this.canvas);
    this.players = new Map();
    this.camera = null;
    new ResizeObserver(() => this.resize()).observe(frame);
    this.canvas.addEventListener("click", (event) => this.pick(event));
    this.resize();
  }

  resize() {
    const box = this.canvas.parentElement.getBoundingClientRect();
    this.ratio = Math.min(3, window.devicePixelRatio || 1);
    this.width = Math.max(200, box.width);
    this.height = Math.max(200, box.height);
    this.canvas.width = Math.round(this.width * this.ratio);
    this.canvas.height = Math.round(this.height * this.ratio);
    this.options.resized();
  }

  player(id) {
    if (!this.players.has(id)) {
      const robot = this.run.byId.get(id);
      const player = robot ? new BeliefPlayer(this.run.grid, robot.belief).own() : new BeliefPlayer(this.run.grid, this.run.teamBelief);
      this.players.set(id, player);
    }
    return this.players.get(id);
  }

  look(t, follow) {
    const { w, h } = this.run.grid;
    let goal = { x: (w - 1) / 2, y: (h - 1) / 2, cells: Math.max(w, h) };
    const robot = this.run.byId.get(follow), place = robot && this.run.place(robot, t);
    if (place && Math.max(w, h) > FOLLOW_CELLS) {
      const half = FOLLOW_CELLS / 2, within = (v, size) => (size <= FOLLOW_CELLS ? (size - 1) / 2 : Math.max(half - 0.5, Math.min(size - half - 0.5, v)));
      goal = { x: within(place.x, w), y: within(place.y, h), cells: FOLLOW_CELLS };
    }
    const c = this.camera ?? goal, ease = this.options.still() ? 1 : 0.14;
    this.camera = { x: c.x + (goal.x - c.x) * ease, y: c.y + (goal.y - c.y) * ease, cells: c.cells + (goal.cells - c.cells) * ease };
    const inner = Math.min(this.width, this.height) - MARGIN - AXES;
    this.cell = inner / this.camera.cells;
    this.moving = Math.abs(goal.cells - this.camera.cells) + Math.hypot(goal.x - this.camera.x, goal.y - this.camera.y) > 0.02;
  }

  px(x) { return (this.width + AXES - MARGIN) / 2 + (x - this.camera.x) * this.cell; }
  py(y) { return (this.height - AXES + MARGIN) / 2 - (y - this.camera.y) * this.cell; }

  draw(t, state) {
    const ctx = (this.ctx = this.canvas.getContext("2d"));
    this.color = state.colors;
    ctx.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    ctx.clearRect(0, 0, this.width, this.height);
    ctx.lineJoin = ctx.lineCap = "round";
    this.look(t, state.follow);
    this.cells(t, state);
    this.axes();
    this.links(t, state);
    this.paths(t, state);
    this.targets(t, state);
    this.visits(t, state);
    for (const robot of this.run.robots) if (robot.id !== state.follow) this.robot(robot, t, state);
    const followed = this.run.byId.get(state.follow);
    if (!followed) return;
    for (const robot of this.run.absent(followed, t)) this.remembered(robot);
    this.robot(followed, t, state);
  }

  cells(t, state) {
    const { ctx, cell, run } = this, { w, h } = run.grid;
    const player = this.player(state.follow), states = state.view === "truth" && run.truth ? run.truth : player.at(t);
    const left = this.px(-0.5), top = this.py(h - 0.5), wide = w * cell, high = h * cell;
    ctx.save();
    ctx.beginPath(); ctx.roundRect(left, top, wide, high, Math.min(10, cell * 0.4)); ctx.clip();
    ctx.fillStyle = this.color.unknown; ctx.fillRect(left, top, wide, high);
    this.hatch(left, top, wide, high);
    const ramp = Math.max(1, run.step_ms * 0.6);
    for (let x = 0; x < w; x++) {
      for (let y = 0; y < h; y++) {
        const code = +states[x * h + y];
        if (code === CELL.UNKNOWN) continue;
        const px = this.px(x - 0.5), py = this.py(y + 0.5);
        if (px > this.width || py > this.height || px < -cell || py < -cell) continue;
        ctx.globalAlpha = state.view === "truth" ? 1 : Math.min(1, 0.15 + (t - player.since[x * h + y]) / ramp);
        ctx.fillStyle = this.color.free; ctx.fillRect(px, py, cell + 0.4, cell + 0.4);
        if (code === CELL.OBSTACLE) this.block(px, py);
      }
    }
    ctx.globalAlpha = 1;
    this.gridLines(w, h);
    ctx.restore();
  }

  hatch(left, top, wide, high) {
    const { ctx } = this;
    ctx.strokeStyle = this.color.hatch; ctx.lineWidth = 1; ctx.beginPath();
    for (let d = -high; d < wide; d += 9) { ctx.moveTo(left + d, top + high); ctx.lineTo(left + d + high, top); }
    ctx.stroke();
  }

  block(px, py) {
    const { ctx, cell } = this, inset = Math.max(0.5, cell * 0.07);
    ctx.fillStyle = this.color.obstacle; ctx.beginPath();
    ctx.roundRect(px + inset, py + inset, cell - 2 * inset, cell - 2 * inset, cell * 0.16); ctx.fill();
  }

  gridLines(w, h) {
    const { ctx } = this;
    if (this.cell < 9) return;
    ctx.strokeStyle = this.color.grid; ctx.lineWidth = 1; ctx.beginPath();
    for (let x = 1; x < w; x++) { ctx.moveTo(this.px(x - 0.5), this.py(-0.5)); ctx.lineTo(this.px(x - 0.5), this.py(h - 0.5)); }
    for (let y = 1; y < h; y++) { ctx.moveTo(this.px(-0.5), this.py(y - 0.5)); ctx.lineTo(this.px(w - 0.5), this.py(y - 0.5)); }
    ctx.globalAlpha = 0.55; ctx.stroke(); ctx.globalAlpha = 1;
  }

  axes() {
    const { ctx, run } = this, every = [5, 10, 20, 50, 100, 200].find((n) => n * this.cell > 46) ?? 500;
    ctx.fillStyle = this.color.muted; ctx.font = "11px system-ui, sans-serif";
    ctx.textAlign = "center"; ctx.textBaseline = "top";
    const bottom = Math.min(this.height - 15, this.py(-0.5) + 7), left = Math.max(16, this.px(-0.5) - 7);
    for (let x = 0; x < run.grid.w; x += every) if (this.px(x) > 20 && this.px(x) < this.width - 10) ctx.fillText(x, this.px(x), bottom);
    ctx.textAlign = "right"; ctx.textBaseline = "middle";
    for (let y = 0; y < run.grid.h; y += every) if (this.py(y) > 10 && this.py(y) < this.height - 20) ctx.fillText(y, left, this.py(y));
  }

  links(t, state) {
    const { ctx, run } = this, drawn = new Set();
    for (const robot of run.robots) {
      const here = run.place(robot, t);
      if (!here) continue;
      for (const id of run.heard(robot, t)) {
        const other = run.byId.get(id), there = other && run.place(other, t), key = Math.min(id, robot.id) * 1000 + Math.max(id, robot.id);
        if (!there || drawn.has(key)) continue;
        drawn.add(key);
        const mine = !state.follow || state.follow === id || state.follow === robot.id;
        ctx.strokeStyle = this.color.muted; ctx.globalAlpha = mine ? 0.42 : 0.12; ctx.lineWidth = mine ? 1.3 : 1;
        ctx.setLineDash([1.5, 4.5]);
        ctx.beginPath(); ctx.moveTo(this.px(here.x), this.py(here.y)); ctx.lineTo(this.px(there.x), this.py(there.y)); ctx.stroke();
      }
    }
    ctx.setLineDash([]); ctx.globalAlpha = 1;
  }

  paths(t, state) {
    for (const robot of this.run.robots) {
      const place = this.run.place(robot, t), task = this.run.task(robot, t);
      if (!place || !task || task[1] === TASK.HOLD) continue;
      const points = ahead(this.run.path(robot, t), place, robot.kind === 0);
      const { ctx } = this, faded = state.follow && state.follow !== robot.id;
      ctx.strokeStyle = this.color[KIND[robot.kind]]; ctx.globalAlpha = faded ? 0.16 : task[1] === TASK.TARGET ? 0.75 : 0.45;
      ctx.lineWidth = Math.max(1.5, this.cell * 0.075);
      if (task[1] === TASK.EXPLORE) ctx.setLineDash([this.cell * 0.16, this.cell * 0.2]);
      ctx.beginPath(); ctx.moveTo(this.px(place.x), this.py(place.y));
      for (const [x, y] of points) ctx.lineTo(this.px(x), this.py(y));
      ctx.stroke(); ctx.setLineDash([]);
      ctx.lineWidth = Math.max(1.5, this.cell * 0.06);
      ctx.beginPath(); ctx.arc(this.px(task[2]), this.py(task[3]), this.cell * 0.42, 0, 7); ctx.stroke();
      ctx.globalAlpha = 1;
    }
  }

  targets(t, state) {
    const { run } = this, states = this.player(state.follow).at(t), h = run.grid.h;
    const truth = state.view === "truth", done = new Set();
    if (truth) for (const [at, , x, y] of run.visits) if (at <= t) done.add(x * h + y);
    for (const [x, y] of run.targets) {
      const code = states[x * h + y];
      if (truth || code < CELL.TARGET) this.diamond(x, y, done.has(x * h + y) ? CELL.LOCALIZED : truth ? CELL.TARGET : 0);
    }
    if (truth) return;
    for (let i = 0; i < states.length; i++) if (states[i] >= CELL.TARGET) this.diamond(Math.floor(i / h), i % h, states[i]);
  }

  diamond(x, y, code) {
    const { ctx } = this, px = this.px(x), py = this.py(y), r = this.cell * 0.25;
    if (code === CELL.LOCALIZED) {
      ctx.fillStyle = this.color.done; ctx.beginPath(); ctx.arc(px, py, this.cell * 0.2, 0, 7); ctx.fill();
      ctx.strokeStyle = this.color.free; ctx.lineWidth = Math.max(1.2, this.cell * 0.06); ctx.beginPath();
      ctx.moveTo(px - r * 0.4, py + r * 0.04); ctx.lineTo(px - r * 0.08, py + r * 0.34); ctx.lineTo(px + r * 0.42, py - r * 0.3); ctx.stroke();
      return;
    }
    ctx.beginPath(); ctx.moveTo(px, py - r); ctx.lineTo(px + r, py); ctx.lineTo(px, py + r); ctx.lineTo(px - r, py); ctx.closePath();
    if (code === CELL.TARGET) { ctx.fillStyle = this.color.target; ctx.fill(); return; }
    ctx.strokeStyle = this.color.muted; ctx.globalAlpha = 0.4; ctx.lineWidth = 1; ctx.stroke(); ctx.globalAlpha = 1;
  }

  visits(t, state) {
    if (this.options.still()) return;
    const { ctx, run } = this, span = run.step_ms * 1.5;
    for (const [at, , x, y] of run.visits) {
      const part = (t - at) / span;
      if (part < 0 || part > 1) continue;
      ctx.strokeStyle = this.color.done; ctx.globalAlpha = 1 - part; ctx.lineWidth = this.cell * 0.09 * (1 - part) + 0.5;
      ctx.beginPath(); ctx.arc(this.px(x), this.py(y), this.cell * (0.3 + 0.75 * part), 0, 7); ctx.stroke(); ctx.globalAlpha = 1;
    }
  }

  robot(robot, t, state) {
    const place = this.run.place(robot, t);
    if (!place) return;
    const { ctx } = this, x = this.px(place.x), y = this.py(place.y), color = this.color[KIND[robot.kind]];
    const followed = state.follow === robot.id, r = Math.max(7, Math.min(19, this.cell * 0.37));
    if (followed || !state.follow) {
      const { w, h } = this.run.grid;
      ctx.save(); ctx.beginPath(); ctx.rect(this.px(-0.5), this.py(h - 0.5), w * this.cell, h * this.cell); ctx.clip();
      ctx.fillStyle = ctx.strokeStyle = color; ctx.globalAlpha = followed ? 0.1 : 0.035;
      ctx.beginPath(); ctx.arc(x, y, (this.run.r_sense + 0.5) * this.cell, 0, 7); ctx.fill();
      if (followed) { ctx.globalAlpha = 0.5; ctx.lineWidth = 1.2; ctx.setLineDash([3, 4]); ctx.stroke(); }
      ctx.restore();
    }
    ctx.globalAlpha = state.follow && !followed ? 0.55 : 1;
    ctx.fillStyle = color; ctx.strokeStyle = this.color.halo; ctx.lineWidth = followed ? 3.4 : 2.2;
    ctx.save(); ctx.translate(x, y); ctx.rotate(place.heading); shape(ctx, robot.kind, r); ctx.stroke(); ctx.fill(); ctx.restore();
    if (followed) { ctx.strokeStyle = color; ctx.lineWidth = 2; ctx.beginPath(); ctx.arc(x, y, r * 1.6, 0, 7); ctx.stroke(); }
    ctx.fillStyle = this.color.halo; ctx.textAlign = "center"; ctx.textBaseline = "middle";
    ctx.font = `700 ${Math.round(r * (robot.id > 9 ? 0.78 : 0.98))}px system-ui, sans-serif`;
    const back = robot.kind === 0 ? r * 0.16 : 0;
    ctx.fillText(robot.id, x - Math.sin(place.heading) * back, y + Math.cos(place.heading) * back + 0.5);
    ctx.globalAlpha = 1;
  }

  // Where the followed robot expects one that it does not hear: hollow, for it may be elsewhere.
  remembered([id, kind, cellX, cellY]) {
    const { ctx } = this, x = this.px(cellX), y = this.py(cellY), r = Math.max(7, Math.min(19, this.cell * 0.37));
    ctx.strokeStyle = ctx.fillStyle = this.color[KIND[kind]]; ctx.lineWidth = 1.8; ctx.setLineDash([3, 2.5]);
    ctx.save(); ctx.translate(x, y); shape(ctx, kind, r); ctx.stroke(); ctx.restore(); ctx.setLineDash([]);
    ctx.textAlign = "center"; ctx.textBaseline = "middle"; ctx.font = `700 ${Math.round(r * 0.78)}px system-ui, sans-serif`;
    ctx.fillText(id, x, y + (kind === 0 ? r * 0.16 : 0));
  }

  pick(event) {
    const box = this.canvas.getBoundingClientRect();
    let best = null, gap = 26;
    for (const robot of this.run.robots) {
      const place = this.run.place(robot, this.options.time());
      const d = place ? Math.hypot(event.clientX - box.left - this.px(place.x), event.clientY - box.top - this.py(place.y)) : 1e9;
      if (d < gap) { gap = d; best = robot.id; }
    }
    this.options.pick(best);
  }
}

// UAV: a triangle, UGV: a square with a nose. Drawn round the origin, looking up.
export function shape(ctx, kind, r) {
  ctx.beginPath();
  if (kind === 0) {
    ctx.moveTo(0, -1.22 * r); ctx.lineTo(1.12 * r, 0.88 * r); ctx.lineTo(0, 0.58 * r); ctx.lineTo(-1.12 * r, 0.88 * r);
  } else {
    ctx.moveTo(0, -1.22 * r); ctx.lineTo(0.84 * r, -0.72 * r); ctx.lineTo(0.84 * r, 0.84 * r); ctx.lineTo(-0.84 * r, 0.84 * r); ctx.lineTo(-0.84 * r, -0.72 * r);
  }
  ctx.closePath();
}

// What of a path's corners still lies before the robot. A UAV flies straight to the end.
function ahead(flat, place, straight) {
  const corners = [];
  for (let i = 0; i < flat.length; i += 2) corners.push([flat[i], flat[i + 1]]);
  if (straight) return corners.slice(-1);
  let best = 0, gap = Infinity;
  for (let i = 0; i + 1 < corners.length; i++) {
    const [[x0, y0], [x1, y1]] = [corners[i], corners[i + 1]];
    const length = Math.hypot(x1 - x0, y1 - y0) || 1, part = Math.max(0, Math.min(1, ((place.x - x0) * (x1 - x0) + (place.y - y0) * (y1 - y0)) / length ** 2));
    const d = Math.hypot(place.x - x0 - part * (x1 - x0), place.y - y0 - part * (y1 - y0));
    if (d < gap - 1e-6) { gap = d; best = i + 1; }
  }
  return corners.slice(best);
}
