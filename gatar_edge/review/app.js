// Puts the page together: one clock, and everything drawn from it.

import { CHARTS, Chart } from "gatar/charts";
import { Lanes, scrubMarks } from "gatar/lanes";
import { MapView } from "gatar/map";
import { Decisions, LEGEND, REMEMBERED, badges, details, drawRobots, esc, headline, perRobot, put, rivalHeadline, robotRows, tiles, why } from "gatar/panel";
import { KIND, Run, lastAt, unpack } from "gatar/run";

const $ = (id) => document.getElementById(id);
const COLORS = ["ink", "muted", "line", "surface", "uav", "ugv", "target", "done", "bad", "free", "unknown", "hatch", "obstacle", "grid", "halo"];
const SPEEDS = [0.25, 0.5, 1, 2, 4, 8, 16, 30, 60, 120];
const calm = matchMedia("(prefers-reduced-motion: reduce)");

const state = { t: 0, playing: false, speed: 1, follow: 0, view: "belief", theme: "light", colors: {}, dirty: true };
let runs = [], maps = [], lanes = [], charts = [], decisions = null, shownEvent, lastFrame = 0;

export async function start() {
  try {
    const blocks = [...document.querySelectorAll("script[data-run]")];
    runs = await Promise.all(blocks.map(async (block) => new Run(await unpack(block.textContent.trim()))));
    span();
    build();
    window.gatar = { state, runs, seek, follow, play, refresh, place: (id) => runs[0].place(runs[0].byId.get(id), state.t) };
    document.body.dataset.ready = String(Math.round(performance.now())); // milliseconds after the address was opened
    if (document.body.dataset.live) setInterval(refresh, 2000);
  } catch (error) {
    $("headline").textContent = "This page cannot be shown";
    $("subline").textContent = typeof DecompressionStream === "undefined" ? "Please open it in a browser of 2023 or later." : String(error);
    throw error;
  }
}

function build() {
  const run = runs[0];
  setTheme(load("theme") ?? (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light"));
  document.body.dataset.runs = runs.length;
  texts();
  const legend = runs.some((r) => r.robots.some((robot) => robot.absent.length)) ? [...LEGEND, REMEMBERED] : LEGEND;
  $("maps").innerHTML = runs.map((r, i) => `<figure class="map"><div class="frame"></div><figcaption><strong>${runs.length > 1 ? `${"AB"[i]}: ${esc(headline(r).title)}` : ""}</strong>${i ? "" : legend.map(([name, svg]) => `<span class="key">${svg}${name}</span>`).join("")}</figcaption></figure>`).join("");
  const options = { resized, still: () => calm.matches, time: () => state.t, pick: (id) => follow(id ?? 0) };
  maps = [...document.querySelectorAll(".map .frame")].map((frame, i) => new MapView(runs[i], frame, options));
  robotRows(run, $("robots"), (id) => follow(state.follow === id ? 0 : id));
  room(); addEventListener("resize", room);
  $("lanes-legend").innerHTML = '<span class="key"><svg viewBox="0 0 16 16"><rect y="3" width="16" height="10" rx="3" fill="var(--muted)"/></svg>to a target</span><span class="key"><svg viewBox="0 0 16 16"><rect y="5" width="16" height="6" rx="3" fill="var(--muted)" opacity=".35"/></svg>exploring</span><span class="key"><svg viewBox="0 0 16 16"><circle cx="8" cy="8" r="5" fill="var(--done)"/></svg>localized a target</span><span class="key"><svg viewBox="0 0 16 16"><circle cx="8" cy="8" r="3" fill="var(--target)"/></svg>gave one up</span>';
  lanes = runs.map((r, i) => new Lanes(r, lanesBox(i), { resized, seek, pick: follow }));
  charts = CHARTS.map((chart) => new Chart(chart, runs, $("charts"), seek));
  decisions = new Decisions(run, $("decisions"), { choose: (event) => { pause(); follow(event.id); seek(event.t); } });
  views(); transport(); keys();
  const asked = hash();
  state.speed = startSpeed(run);
  $("speed").value = state.speed;
  if (asked.robot) follow(asked.robot);
  if (asked.t !== undefined) seek(asked.t * 1000); else if (!calm.matches && !document.body.dataset.live) play();
  if (document.body.dataset.live) seek(run.duration);
  addEventListener("hashchange", () => { const to = hash(); if (to.robot !== undefined) follow(to.robot); if (to.t !== undefined) { pause(); seek(to.t * 1000); } });
  requestAnimationFrame(frame);
}

// What the page leaves to a map that is to be seen as a whole above the player.
function room() {
  const height = (part) => document.querySelector(part).offsetHeight;
  for (const _ of "12") { // twice: how the legend wraps depends on the map's width
    const around = $("stage").getBoundingClientRect().top + scrollY + height(".map figcaption") + height(".transport");
    document.documentElement.style.setProperty("--room", `${Math.max(320, Math.round(innerHeight - around - 14))}px`);
  }
}

function lanesBox(index) {
  if (runs.length > 1) $("lanes").insertAdjacentHTML("beforeend", `<h3>${"AB"[index]}: ${esc(runs[index].run.allocator)}</h3>`);
  return $("lanes").appendChild(Object.assign(document.createElement("div"), { className: "lane-box" }));
}

function texts() {
  const head = headline(runs[0]);
  document.title = `${head.title} – gatar`;
  put($("headline"), runs.length > 1 ? rivalHeadline(runs) : head.title);
  put($("subline"), runs.length > 1 ? `A: ${head.facts}\nB: ${headline(runs[1]).facts}` : head.facts);
  $("badges").innerHTML = badges(runs[0]);
  $("tiles").innerHTML = tiles(runs);
  $("per-robot").innerHTML = perRobot(runs[0]);
  $("details").innerHTML = details(runs[0]);
}

function hash() {
  const asked = new URLSearchParams(location.hash.slice(1)), out = {};
  if (asked.has("t") && Number.isFinite(+asked.get("t"))) out.t = +asked.get("t");
  if (asked.has("robot") && runs[0].byId.has(+asked.get("robot"))) out.robot = +asked.get("robot");
  return out;
}

// A whole mission in about half a minute.
function startSpeed(run) { return SPEEDS.reduce((best, s) => (Math.abs(run.duration / s - 25000) < Math.abs(run.duration / best - 25000) ? s : best)); }

function views() {
  const all = [["belief", "Known"], ["truth", "True"]].filter(([name]) => name !== "truth" || runs[0].truth);
  $("views").innerHTML = all.length > 1 ? all.map(([name, text]) => `<button type="button" data-view="${name}" aria-pressed="${name === state.view}">${text}</button>`).join("") : "";
  $("views").onclick = (event) => {
    const name = event.target.dataset?.view;
    if (!name) return;
    state.view = name; redraw();
    for (const button of $("views").children) button.setAttribute("aria-pressed", button.dataset.view === name);
  };
}

function span() { for (const run of runs) run.span = duration(); }
function duration() { return Math.max(...runs.map((r) => r.duration)); }

function transport() {
  $("scrub").max = duration();
  $("scrub").oninput = () => { seek(+$("scrub").value); };
  $("play").onclick = toggle;
  $("theme").onclick = () => setTheme(state.theme === "dark" ? "light" : "dark", true);
  $("speed").innerHTML = SPEEDS.map((s) => `<option value="${s}">${s} ×</option>`).join("");
  $("speed").onchange = () => { state.speed = +$("speed").value; };
}

export function seek(t) { state.t = Math.max(0, Math.min(duration(), t)); redraw(); if (!state.playing) say(); }
export function follow(id) { state.follow = runs[0].byId.has(id) ? id : 0; redraw(); say(); }
export function play() { if (state.t >= duration()) state.t = 0; setPlaying(true); }
function pause() { setPlaying(false); }
function toggle() { if (state.playing) pause(); else play(); }
function redraw() { state.dirty = true; }
function resized() { if (document.body.dataset.ready) draw(); } // at once: a canvas that changed its size is empty

function setPlaying(on) {
  state.playing = on;
  $("play").setAttribute("aria-pressed", on); $("play").setAttribute("aria-label", on ? "Pause" : "Play");
  $("play-icon").setAttribute("d", on ? "M3.5 2.5h3v11h-3zM9.5 2.5h3v11h-3z" : "M4 2.5v11l9-5.5Z");
  if (!on) say();
}

function setTheme(name, keep) {
  state.theme = document.documentElement.dataset.theme = name;
  if (keep) save("theme", name);
  const style = getComputedStyle(document.documentElement);
  state.colors = Object.fromEntries(COLORS.map((color) => [color, style.getPropertyValue(`--${color}`).trim()]));
  state.colors.UAV = state.colors.uav; state.colors.UGV = state.colors.ugv;
  redraw();
}

function load(key) { try { return localStorage.getItem(`gatar-${key}`); } catch { return null; } }
function save(key, value) { try { localStorage.setItem(`gatar-${key}`, value); } catch { /* a page from a file may not store */ } }

function keys() {
  const step = () => runs[0].step_ms, actions = {
    " ": toggle, ArrowLeft: (e) => { pause(); seek(state.t - step() * (e.shiftKey ? 10 : 1)); }, ArrowRight: (e) => { pause(); seek(state.t + step() * (e.shiftKey ? 10 : 1)); },
    Home: () => seek(0), End: () => { pause(); seek(duration()); }, ",": () => jump(-1), ".": () => jump(1),
    "+": () => speed(1), "=": () => speed(1), "-": () => speed(-1), d: () => $("theme").click(), Escape: () => follow(0), 0: () => follow(0),
  };
  addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || /^(SELECT|TEXTAREA)$/.test(event.target.tagName)) return;
    if (event.key === " " && event.target.tagName === "BUTTON" && event.target.id !== "play") return;
    if (/^[1-9]$/.test(event.key)) { const robot = runs[0].robots[+event.key - 1]; if (robot) follow(state.follow === robot.id ? 0 : robot.id); return; }
    const action = actions[event.key];
    if (action) { event.preventDefault(); action(event); }
  });
}

function speed(by) {
  state.speed = SPEEDS[Math.max(0, Math.min(SPEEDS.length - 1, SPEEDS.indexOf(state.speed) + by))];
  $("speed").value = state.speed;
}

// To the previous or next change of mind of the followed robot, or of anybody.
function jump(by) {
  pause();
  const times = runs[0].events.filter((e) => !state.follow || e.id === state.follow).map((e) => e.t);
  const next = by > 0 ? times.find((t) => t > state.t + 1) : times.findLast((t) => t < state.t - 1);
  if (next !== undefined) seek(next);
}

function frame(now) {
  const passed = Math.min(100, now - lastFrame);
  lastFrame = now;
  if (state.playing) {
    state.t += passed * state.speed; state.dirty = true;
    if (state.t >= duration()) { state.t = duration(); pause(); }
  }
  if (state.dirty || maps.some((map) => map.moving)) { state.dirty = false; draw(); }
  requestAnimationFrame(frame);
}

function draw() {
  const run = runs[0], { t } = state;
  for (const [i, map] of maps.entries()) map.draw(Math.min(t, runs[i].duration), state);
  for (const lane of lanes) lane.draw(t, state);
  for (const chart of charts) chart.draw(t);
  scrubMarks($("scrub-marks"), run, t, state.colors);
  drawRobots(run, $("robots"), t, state.follow);
  drawWhy(run, t);
  $("scrub").value = t;
  $("scrub").setAttribute("aria-valuetext", `${run.label(t)} of ${run.label(duration())}`);
  const html = `${run.label(t)}<small>step ${run.step(t).toFixed(1)} of ${run.step(duration()).toFixed(0)}</small>`;
  if ($("clock").innerHTML !== html) $("clock").innerHTML = html;
  const count = `<b>${run.localized(t)}</b>${run.reachable ? ` of ${run.reachable}` : ""}`;
  if ($("count").innerHTML !== count) $("count").innerHTML = count;
}

function drawWhy(run, t) {
  const robot = run.byId.get(state.follow);
  const latest = robot ? run.event(robot, t) : run.events[lastAt(run.events, t, (e) => e.t)] ?? null;
  const key = robot ? latest : "team";
  if (!robot) {
    const end = lastAt(run.events, t, (e) => e.t) + 1, recent = run.events.slice(Math.max(0, end - (innerWidth > 980 ? 14 : 5)), end).reverse();
    const html = `<h2>Latest changes</h2><p class="when">Choose a robot to see through its eyes and read why it does what it does.</p><ul class="reasons">${recent.map((e) => `<li class="${KIND[run.byId.get(e.id).kind].toLowerCase()}">${run.label(e.t)}: ${esc(e.head)}</li>`).join("")}</ul>`;
    if (html !== shownEvent) { $("why").innerHTML = html; shownEvent = html; $("why").className = "card why"; }
    return;
  }
  if (key === shownEvent) return;
  shownEvent = key;
  $("why").className = `card why ${KIND[robot.kind].toLowerCase()}`;
  $("why").innerHTML = latest ? `<h2>Why ${KIND[robot.kind]} ${robot.id} does this</h2>${why(run, latest)}` : `<h2>${KIND[robot.kind]} ${robot.id}</h2><p class="when">It has not decided anything yet.</p>`;
}

// For screen readers, when something was chosen and not while it plays.
function say() {
  if (!runs.length || state.playing) return;
  const run = runs[0], robot = run.byId.get(state.follow), { t } = state;
  const event = robot && run.event(robot, t);
  const text = `${run.label(t)}: ${run.localized(t)}${run.reachable ? ` of ${run.reachable}` : ""} targets localized. ${robot ? event?.head ?? "" : "Following the team."}`;
  put($("live"), text);
  for (const map of maps) map.canvas.setAttribute("aria-label", `Map. ${text}`);
}

async function refresh() {
  try {
    const answer = await fetch(document.body.dataset.live, { cache: "no-store" });
    if (!answer.ok) return;
    const atEnd = state.t >= duration() - 1, fresh = new Run(await answer.json());
    if (fresh.duration === runs[0].duration && fresh.finished === runs[0].finished) return;
    runs[0] = window.gatar.runs[0] = fresh; span();
    for (const map of maps) { map.run = fresh; map.players.clear(); }
    lanes[0].run = fresh; lanes[0].resize();
    $("charts").innerHTML = ""; charts = CHARTS.map((chart) => new Chart(chart, runs, $("charts"), seek));
    if (fresh.robots.length !== $("robots").children.length) robotRows(fresh, $("robots"), (id) => follow(id));
    decisions.run = fresh; decisions.fill();
    $("scrub").max = duration(); texts(); shownEvent = undefined;
    if (atEnd) seek(duration()); else redraw();
  } catch { /* the server may be gone; the page stays as it is */ }
}
