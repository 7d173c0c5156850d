// One mission: unpacks the embedded data and answers "what was at time t?". Times are milliseconds.

export const TASK = { HOLD: 0, TARGET: 1, EXPLORE: 2 };
export const CELL = { UNKNOWN: 0, FREE: 1, OBSTACLE: 2, TARGET: 3, LOCALIZED: 4 };
export const KIND = ["UAV", "UGV"];

export async function unpack(base64) {
  const bytes = Uint8Array.from(atob(base64), (c) => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return JSON.parse(await new Response(stream).text());
}

// Index of the last row whose first item is <= t; -1 before the first.
export function lastAt(rows, t, get = (row) => row[0]) {
  let low = 0, high = rows.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (get(rows[middle]) <= t) low = middle + 1; else high = middle;
  }
  return low - 1;
}

export class Run {
  constructor(data) {
    Object.assign(this, data);
    this.data = data;
    this.byId = new Map(data.robots.map((robot) => [robot.id, robot]));
    for (const robot of data.robots) robot.travel = travelled(robot.track);
    this.teamBelief = merge(data.robots);
    this.reachable = data.result.reachable ?? data.targets.length;
    this.duration = Math.max(1, data.duration);
  }

  // Place, heading (radians, 0 north, clockwise) and cells travelled at t.
  place(robot, t) {
    const track = robot.track, count = track.length / 3;
    if (!count) return null;
    let low = 0, high = count;
    while (low < high) { const m = (low + high) >> 1; if (track[3 * m] <= t) low = m + 1; else high = m; }
    const i = Math.max(0, low - 1), j = Math.min(count - 1, i + 1);
    const [t0, x0, y0, t1, x1, y1] = [...track.slice(3 * i, 3 * i + 3), ...track.slice(3 * j, 3 * j + 3)];
    const part = t1 > t0 ? Math.min(1, Math.max(0, (t - t0) / (t1 - t0))) : 0;
    let k = j;
    while (k > 0 && track[3 * k + 1] === track[3 * k - 2] && track[3 * k + 2] === track[3 * k - 1]) k--;
    const [dx, dy] = k > 0 ? [track[3 * k + 1] - track[3 * k - 2], track[3 * k + 2] - track[3 * k - 1]] : [0, 1];
    const [a, b] = [robot.travel[i], robot.travel[j]];
    return { x: x0 + (x1 - x0) * part, y: y0 + (y1 - y0) * part, heading: Math.atan2(dx, dy), travel: a + (b - a) * part };
  }

  task(robot, t) { return robot.tasks[lastAt(robot.tasks, t)] ?? null; }
  event(robot, t) { const task = this.task(robot, t); return task && task[4] >= 0 ? this.events[task[4]] : null; }
  path(robot, t) { return robot.paths[lastAt(robot.paths, t)]?.slice(1) ?? []; }
  heard(robot, t) { return robot.links[lastAt(robot.links, t)]?.slice(1) ?? []; }
  vehicle(robot, t) { return robot.vehicle[lastAt(robot.vehicle, t)] ?? null; }
  // Robots out of range that it reckons with: [id, kind, x, y] where it expects each.
  absent(robot, t) {
    const row = robot.absent[lastAt(robot.absent, t)] ?? [], found = [];
    for (let i = 1; i < row.length; i += 4) found.push(row.slice(i, i + 4));
    return found;
  }
  localized(t) { return lastAt(this.visits, t) + 1; }
  distance(kind, t) {
    return this.robots.reduce((sum, r) => sum + (r.kind === kind ? this.place(r, t)?.travel ?? 0 : 0), 0);
  }
  label(t) {
    const seconds = t / 1000;
    if (this.duration < 600_000) return `${seconds.toFixed(1)} s`;
    return `${Math.floor(seconds / 60)}:${(seconds % 60).toFixed(1).padStart(4, "0")}`;
  }
  step(t) { return t / this.step_ms; }
}

function travelled(track) {
  const sums = new Float64Array(track.length / 3);
  for (let i = 1; i < sums.length; i++) {
    sums[i] = sums[i - 1] + Math.hypot(track[3 * i + 1] - track[3 * i - 2], track[3 * i + 2] - track[3 * i - 1]);
  }
  return sums;
}

function merge(robots) {
  return robots.flatMap((robot) => robot.belief).sort((a, b) => a[0] - b[0]);
}

// Plays changes of a belief; the team's is the highest state that anybody holds of a cell.
export class BeliefPlayer {
  constructor(grid, rows) {
    this.rows = rows;
    this.states = new Uint8Array(grid.w * grid.h);
    this.since = new Float64Array(grid.w * grid.h);
    this.next = 0;
    this.t = -Infinity;
    this.team = true;
  }
  own() { this.team = false; return this; }
  at(t) {
    if (t < this.t) { this.states.fill(0); this.next = 0; }
    this.t = t;
    for (; this.next < this.rows.length && this.rows[this.next][0] <= t; this.next++) {
      const row = this.rows[this.next];
      for (let i = 1; i < row.length; i++) {
        const cell = row[i] >> 3, state = row[i] & 7;
        if (this.team ? state > this.states[cell] : state !== this.states[cell]) {
          if (this.states[cell] === CELL.UNKNOWN) this.since[cell] = row[0];
          this.states[cell] = state;
        }
      }
    }
    return this.states;
  }
}

export function taskText(task) {
  if (!task) return "no decision yet";
  if (task[1] === TASK.TARGET) return `target (${task[2]}, ${task[3]})`;
  return task[1] === TASK.EXPLORE ? `exploring to (${task[2]}, ${task[3]})` : "holding";
}
