// Everything in words and numbers: the headline, tiles, robots, explanations and tables.

import { KIND, taskText } from "gatar/run";

export const esc = (text) => String(text ?? "").replace(/[&<>"']/g, (c) => `&#${c.charCodeAt(0)};`);
const plural = (n, noun) => `${n} ${noun}${n === 1 ? "" : "s"}`;
const number = (v, digits = 1) => (v === null || v === undefined ? "–" : Math.abs(v) >= 10000 ? `${(v / 1000).toFixed(1)}k` : Number.isInteger(v) ? v.toLocaleString("en") : v.toFixed(digits));
const bytes = (v) => (v >= 1e6 ? `${(v / 1e6).toFixed(1)}<small>MB` : `${(v / 1e3).toFixed(1)}<small>kB`);
const REASONS = { allocated: "allocated", kept: "kept", frontier: "explores", nothing_left: "nothing left", no_perception: "no perception" };
export const reasonText = (reason) => REASONS[reason] ?? reason;

export const glyph = (kind, color = `var(--${KIND[kind].toLowerCase()})`) => kind === 0
  ? `<svg viewBox="-11 -11 22 22" aria-hidden="true"><path fill="${color}" d="M0-9.6 9 8 0 5.6-9 8Z"/></svg>`
  : `<svg viewBox="-11 -11 22 22" aria-hidden="true"><path fill="${color}" d="M0-9 7-5V7.5H-7V-5Z"/></svg>`;
export const LEGEND = [
  ["UAV", glyph(0)], ["UGV", glyph(1)],
  ["open target", '<svg viewBox="-8 -8 16 16" aria-hidden="true"><path fill="var(--target)" d="M0-7 7 0 0 7-7 0Z"/></svg>'],
  ["localized", '<svg viewBox="-8 -8 16 16" aria-hidden="true"><circle r="6" fill="var(--done)"/><path d="M-2.6.2-.6 2.4 2.8-2" fill="none" stroke="var(--surface)" stroke-width="1.7"/></svg>'],
  ["heard directly", '<svg viewBox="-8 -8 16 16" aria-hidden="true"><path d="M-7 4 7-4" stroke="var(--muted)" stroke-width="1.6" stroke-dasharray="1.5 2.6"/></svg>'],
  ["not seen yet", '<svg viewBox="-8 -8 16 16" aria-hidden="true"><rect x="-7" y="-7" width="14" height="14" rx="3" fill="var(--unknown)"/><path d="M-7 3 3-7M-3 7 7-3" stroke="var(--hatch)" stroke-width="1.4"/></svg>'],
];

export const REMEMBERED = ["out of range, where it is expected", '<svg viewBox="-11 -11 22 22" aria-hidden="true"><path fill="none" stroke="var(--uav)" stroke-width="1.8" stroke-dasharray="3 2.5" d="M0-9.6 9 8 0 5.6-9 8Z"/></svg>'];

export function headline(run) {
  const { result: r } = run, count = (kind) => run.robots.filter((robot) => robot.kind === kind).length;
  const end = r.steps_100 ?? null;
  const what = `${r.localized} of ${r.reachable ?? r.targets} ${r.truth === false ? "known " : ""}targets localized`;
  const team = [0, 1].filter(count).map((kind) => plural(count(kind), KIND[kind])).join(" and ");
  const when = end !== null ? `in ${number(end)} steps` : `in ${run.label(run.duration)}`;
  const facts = [team, `${run.run.allocator} allocator`, run.run.seed !== undefined ? `seed ${run.run.seed}` : "", `${run.grid.w} × ${run.grid.h} cells of ${number(run.grid.cell_m)} m`, run.name];
  return { title: `${what} ${when}`, facts: facts.filter(Boolean).join(" · ") };
}

export function rivalHeadline(runs) {
  const end = (run) => { const r = run.result; return `${r.localized} of ${r.reachable} ${r.steps_100 ? `in ${number(r.steps_100)} steps` : `in ${run.label(run.duration)}`}`; };
  return `A: ${end(runs[0])}, B: ${end(runs[1])}`;
}

export function badges(run) {
  const marks = [], health = run.health;
  if (!run.finished) marks.push(["The recording did not end properly", "bad"]);
  if (run.result.fallbacks) marks.push([`${plural(run.result.fallbacks, "fallback")} of the allocator`, "bad"]);
  if (run.faults.length) marks.push([plural(run.faults.length, "injected fault"), ""]);
  if (Object.keys(health.gaps_s).length) marks.push([`Gaps: robots ${Object.keys(health.gaps_s).join(", ")}`, "bad"]);
  if (health.warnings.length) marks.push([plural(health.warnings.length, "warning"), "bad"]);
  return marks.map(([text, kind]) => `<span class="badge ${kind}">${esc(text)}</span>`).join("");
}

export function tiles(runs) {
  const rows = [
    ["Localized", (r) => `${r.localized}<small>of ${r.reachable}${r.truth === false ? " known" : ""}</small>`, (r) => r.localized / Math.max(1, r.reachable)],
    ["By step 10 / 20 / 40", (r) => r.localized_by && Object.values(r.localized_by).join("<small>/</small>")],
    ["Steps to 90 %", (r) => number(r.steps_90)],
    ["Steps to 100 %", (r) => number(r.steps_100)],
    ["Distance UAV / UGV", (r) => `${number(Math.round(r.distance_cells.UAV))}<small>/</small>${number(Math.round(r.distance_cells.UGV))}<small>cells</small>`],
    ["Tasks given up", (r) => number(r.retasks)],
    ["Sent per robot", (r) => `${bytes(r.bytes_per_robot)} / ${number(Math.round(r.messages_per_robot))} messages</small>`],
    ["Decision p50 / p99", (r) => `${number(r.decision_p50_us / 1000, 2)}<small>/</small>${number(r.decision_p99_us / 1000, 2)}<small>ms</small>`],
  ];
  return rows.map(([name, text, part]) => {
    const value = text(runs[0].result), rival = runs[1] && `<span class="rival">B: ${text(runs[1].result) ?? "–"}</span>`;
    const bar = part && value !== null ? `<div class="bar"><i style="width:${100 * part(runs[0].result)}%"></i></div>` : "";
    return `<div class="tile"><div class="name">${name}</div><div class="value">${value ?? "–"}</div>${rival ?? ""}${bar}</div>`;
  }).join("");
}

export function robotRows(run, parent, pick) {
  parent.innerHTML = run.robots.map((robot) => `<li><button type="button" class="${KIND[robot.kind].toLowerCase()}" data-id="${robot.id}" aria-pressed="false">${glyph(robot.kind)}<span class="who">${KIND[robot.kind]} ${robot.id}</span><span class="doing"><span></span><span class="mode"></span></span><span class="hears" title="robots heard directly"></span></button></li>`).join("");
  parent.addEventListener("click", (event) => { const button = event.target.closest("button"); if (button) pick(+button.dataset.id); });
}

export function drawRobots(run, parent, t, follow) {
  for (const button of parent.querySelectorAll("button")) {
    const robot = run.byId.get(+button.dataset.id), vehicle = run.vehicle(robot, t), heard = run.heard(robot, t).length;
    put(button.querySelector(".doing").firstChild, taskText(run.task(robot, t)));
    put(button.querySelector(".mode"), vehicle?.[1] ? ` · ${vehicle[1]}` : "");
    put(button.querySelector(".hears"), `hears ${heard}`);
    const pressed = String(follow === robot.id);
    if (button.getAttribute("aria-pressed") !== pressed) button.setAttribute("aria-pressed", pressed);
  }
}

export function why(run, event) {
  const robot = run.byId.get(event.id);
  const tags = [event.retask && '<span class="tag retask">gave up a target</span>', event.fallback && '<span class="tag fallback">fallback</span>'].filter(Boolean).join(" ");
  const targets = event.targets.length ? `<h3>Open targets it knew${event.known > event.targets.length ? ` (${event.targets.length} of ${event.known})` : ""}</h3><table><thead><tr><th scope="col">Target</th><th scope="col" class="num">Way</th><th scope="col" class="num">Score</th><th scope="col">Joint solution</th><th scope="col">Claimed</th></tr></thead><tbody>${event.targets.map(targetRow).join("")}</tbody></table>` : "";
  const attention = event.heard.some((h) => h[6] !== null);
  const heard = event.heard.length ? `<h3>Robots it had heard</h3><table><thead><tr><th scope="col">Robot</th><th scope="col">Hops</th><th scope="col" class="num">Age</th>${attention ? '<th scope="col" class="num">Attention</th>' : ""}<th scope="col">Its task</th></tr></thead><tbody>${event.heard.map((h) => heardRow(run, h, attention)).join("")}</tbody></table>` : "<h3>It had heard nobody.</h3>";
  const absent = event.absent.length ? `<h3>Out of range, reckoned with</h3><table><thead><tr><th scope="col">Robot</th><th scope="col" class="num">Silent</th><th scope="col">Expected at</th><th scope="col">Its task</th><th scope="col">Kept for it</th></tr></thead><tbody>${event.absent.map(absentRow).join("")}</tbody></table>` : "";
  return `<div class="${KIND[robot.kind].toLowerCase()}"><p class="when">${run.label(event.t)} · tick ${event.tick} · ${esc(event.by)} · ${event.ms.toFixed(2)} ms ${tags}</p><p class="head">${esc(event.head)}</p><ul class="reasons">${event.why.map((line) => `<li>${esc(line)}</li>`).join("")}</ul>${targets}${heard}${absent}</div>`;
}

function targetRow([x, y, length, score, given, claimed, chosen]) {
  const robot = (id) => (id < 0 ? "" : `robot ${id}`);
  return `<tr${chosen ? ' style="font-weight:620"' : ""}><td>(${x}, ${y})${chosen ? " ←" : ""}</td><td class="num">${length < 0 ? "none" : length}</td><td class="num">${score === null ? "–" : +score.toPrecision(3)}</td><td>${robot(given)}</td><td>${robot(claimed)}</td></tr>`;
}

function heardRow(run, [id, hops, age, task, x, y, attention], withAttention) {
  const kind = run.byId.get(id)?.kind ?? 0, share = withAttention ? `<td class="num">${attention === null ? "" : `${(100 * attention).toFixed(0)} %`}</td>` : "";
  return `<tr><td>${KIND[kind]} ${id}</td><td>${hops < 0 ? "far" : hops}</td><td class="num">${age.toFixed(1)} s</td>${share}<td>${esc(taskText([0, task, x, y]))}</td></tr>`;
}

function absentRow([id, kind, silent, x, y, task, taskX, taskY, given]) {
  return `<tr><td>${KIND[kind]} ${id}</td><td class="num">${silent.toFixed(1)} s</td><td>(${x}, ${y})</td><td>${esc(taskText([0, task, taskX, taskY]))}</td><td>${given ? `(${given[0]}, ${given[1]})` : ""}</td></tr>`;
}

const PAGE = 200;

export class Decisions {
  constructor(run, root, options) {
    Object.assign(this, { run, options, body: root.querySelector("tbody"), shown: PAGE, open: null });
    this.more = document.getElementById("decisions-more");
    this.robot = document.getElementById("filter-robot"); this.reason = document.getElementById("filter-reason"); this.retask = document.getElementById("filter-retask");
    this.robot.innerHTML = '<option value="">all</option>' + run.robots.map((r) => `<option value="${r.id}">${KIND[r.kind]} ${r.id}</option>`).join("");
    this.reason.innerHTML = '<option value="">all</option>' + [...new Set(run.events.map((e) => e.reason))].map((r) => `<option value="${esc(r)}">${esc(reasonText(r))}</option>`).join("");
    for (const input of [this.robot, this.reason, this.retask]) input.onchange = () => { this.shown = PAGE; this.open = null; this.fill(); };
    this.body.onclick = (event) => this.click(event);
    this.more.onclick = () => { this.shown += PAGE; this.fill(); };
    this.fill();
  }

  fill() {
    const { robot, reason, retask, run } = this;
    const found = run.events.map((e, i) => [e, i]).filter(([e]) => (!robot.value || e.id === +robot.value) && (!reason.value || e.reason === reason.value) && (!retask.checked || e.retask));
    this.body.innerHTML = found.slice(0, this.shown).map(([e, i]) => this.row(e, i)).join("");
    const rest = found.length - this.shown;
    this.more.innerHTML = rest > 0 ? `<button type="button">Show ${Math.min(rest, PAGE)} more of ${rest}</button>` : found.length ? "" : "No decision is like that.";
    if (run.events_left_out) this.more.append(` ${run.events_left_out} later changes are only in the log.`);
  }

  row(event, index) {
    const kind = this.run.byId.get(event.id).kind, tag = event.retask ? ' <span class="tag retask">gave up</span>' : event.fallback ? ' <span class="tag fallback">fallback</span>' : "";
    return `<tr class="row" data-index="${index}"><td><button type="button" aria-expanded="false">${this.run.label(event.t)}</button></td><td>${KIND[kind]} ${event.id}</td><td>${esc(taskText([0, event.kind, ...event.cell]))}</td><td>${esc(reasonText(event.reason))}${tag}</td><td class="num">${event.known}</td><td class="num">${event.heard.length}</td><td class="num">${event.ms.toFixed(2)} ms</td></tr>`;
  }

  click(clicked) {
    const row = clicked.target.closest("tr.row");
    if (!row) return;
    const event = this.run.events[+row.dataset.index], same = this.open === row;
    this.body.querySelector("tr.detail")?.remove();
    this.body.querySelector('[aria-expanded="true"]')?.setAttribute("aria-expanded", "false");
    this.open = same ? null : row;
    if (same) return;
    row.querySelector("button").setAttribute("aria-expanded", "true");
    row.insertAdjacentHTML("afterend", `<tr class="detail"><td colspan="7"><div class="card why">${why(this.run, event)}</div></td></tr>`);
    this.options.choose(event);
  }
}

export function perRobot(run) {
  const rows = run.robot_figures.map((f) => `<tr><td>${f.kind} ${f.robot_id}</td><td class="num">${number(f.decisions)}</td><td class="num">${number(f.retasks)}</td><td class="num">${number(f.distance_cells)}</td><td class="num">${number(f.messages)}</td><td class="num">${number(f.message_bytes / 1000)}</td><td class="num">${number(f.heard)}</td><td class="num">${number(f.heard_outcomes.accepted ?? 0)}</td></tr>`).join("");
  const heads = ["Decisions", "Given up", "Cells", "Sent", "kB sent", "Heard", "New"];
  return `<table><thead><tr><th scope="col">Robot</th>${heads.map((h) => `<th scope="col" class="num">${h}</th>`).join("")}</tr></thead><tbody>${rows}</tbody></table>`;
}

export function details(run) {
  const { run: info, health } = run, versions = info.versions ?? {};
  const rows = [
    ["Allocator", info.allocator], ["Model", [info.model, info.model_sha256?.slice(0, 16)].filter(Boolean).join(" · sha256 ")],
    ["Team", info.team], ["Seed", info.seed], ["Radio range", `${number(run.r_comm)} cells`], ["View", `${number(run.r_sense)} cells`],
    ["Recording", health.ok ? "complete, in order, without gaps" : "see the marks above"],
    ["Delay on the air", `p50 ${number(health.delay_p50_ms)} ms, p99 ${number(health.delay_p99_ms)} ms`],
    ["Refused datagrams", number(health.datagrams_refused)],
    ["Warnings", health.warnings.slice(0, 8).join("; ")],
    ["Faults", Object.entries(health.faults).map(([k, n]) => `${k} × ${n}`).join(", ")],
    ["Versions", Object.entries(versions).map(([k, v]) => `${k} ${v}`).join(", ")],
  ];
  return rows.filter(([, value]) => value !== undefined && value !== null && value !== "").map(([name, value]) => `<dt>${name}</dt><dd>${esc(value)}</dd>`).join("");
}

export function put(node, text) { if (node.textContent !== text) node.textContent = text; }

