// The page: it asks for the picture of a time window whenever the browser is about to draw, and keeps nothing else.
import { makeScopes, traceTable } from "./scopes.js";
import { drawDevice, energyWords, makeTouch } from "./devices.js";
import { makeAct } from "./act.js";

const $ = (id) => document.getElementById(id);
const token = new URLSearchParams(location.search).get("token") || "";
const headers = { "X-Hil-Token": token };
export const text = (tag, words, attributes = {}) => {
  const made = Object.assign(document.createElement(tag), attributes);
  made.textContent = words;
  return made;
};
export const number = (v, digits = 4) => {
  if (v == null || Number.isNaN(v)) return "–";
  const rounded = +(+v).toPrecision(digits);
  return (rounded !== 0 && Math.abs(rounded) < 1e-4 ? rounded.toExponential() : String(rounded)).replaceAll("-", "−");
};
const apart = (a, b) => {  // digits by which two numbers are seen to differ
  let digits = 4;
  while (digits < 12 && a !== b && number(a, digits) === number(b, digits)) digits++;
  return digits;
};
const SIGN = { certified: ["✓", "good"], refused: ["✗", "bad"], undecided: ["?", "warning"], none: ["?", "warning"] };
export const MEANS = { certified: "stable", refused: "not stable", undecided: "undecided", none: "no certificate" };
const STATUS = { running: ["▶", "good"], paused: ["❚❚", "warning"], ended: ["■", ""], log: ["≡", ""], waiting: ["·", ""], lost: ["✗", "bad"] };

export function badge(place, [sign, state], words) {
  place.className = "badge " + state;
  place.replaceChildren(text("span", sign, { className: "sign", ariaHidden: "true" }), text("span", words, { className: "what" }));
}

export const claimBadge = (place, claim) => {
  const digits = claim.limit == null ? 4 : apart(claim.number, claim.limit);
  const limit = claim.limit == null ? "" : ` (limit ${number(claim.limit, digits)})`;
  badge(place, SIGN[claim.state] || SIGN.none, (claim.kind === "passivity" && claim.state === "certified" ? "passive" : MEANS[claim.state]) +
    (claim.number == null ? "" : `: ${claim.quantity || "margin"} ${number(claim.number, digits)}${limit}`));
};

// One wish after the other: on two connections a later one could come before an earlier one.
let before = Promise.resolve();
const wish = (body) => (before = before.catch(() => false).then(() => send(body)));

async function send(body) {
  const answer = await fetch("do", { method: "POST", headers, body: JSON.stringify(body) });
  const said = await answer.json();
  if (!answer.ok) say(said.error, true);
  return answer.ok;
}

let spoken = 0;
function say(words, now = false) {
  if (!now && performance.now() - spoken < 5000) return;
  spoken = performance.now();
  $("words").textContent = words;
}

// One run: its head with certificate, device and counters, and its scopes.
function makeRun(about, index) {
  const place = text("article", "", { className: "run" });
  const head = document.createElement("header");
  const badgeAt = document.createElement("span"), claim = text("p", ""), rests = document.createElement("details"), counters = text("p", ""), values = text("p", "");
  const canvas = Object.assign(document.createElement("canvas"), { width: 340, height: 340 });
  canvas.setAttribute("role", "img");
  const late = text("div", "", { className: "late" });
  const beside = document.createElement("div");
  beside.append(badgeAt, claim, rests, values, counters, late);
  const top = text("div", "", { className: "top" });
  top.append(canvas, beside);
  head.append(text("h2", about.name), top);
  place.append(head);
  $("runs").append(place);
  const scopes = makeScopes(place, about, view);
  if (about.controllable && token) makeTouch(canvas, about, (path, value) => wish({ do: "apply", path, value }));
  return { about, index, canvas, badgeAt, claim, rests, counters, values, late, scopes, since: 0, events: [], now: null, worded: 0 };
}

function showWords(run) {
  const { now, about } = run;
  claimBadge(run.badgeAt, now.certificate);
  run.claim.textContent = now.certificate.reason;
  const rests = (now.certificate.assumptions || []).join("; ");
  run.rests.hidden = !rests;
  if (run.rests.textContent !== `assumptions${rests}`) run.rests.replaceChildren(text("summary", "assumptions"), text("p", rests));
  const fates = Object.entries(now.fates).map(([topic, n]) =>
    `${topic.endsWith("sc") ? "to the controller" : "to the actuator"}: ${Object.entries(n).map(([k, v]) => `${v} ${k.replace("-", " ")}`).join(", ") || "nothing lost"}`);
  const t = now.timing;
  run.counters.textContent = [
    ...fates, `${now.changes} change${now.changes === 1 ? "" : "s"}`, `${now.refused} request${now.refused === 1 ? "" : "s"} refused`,
    ...(t ? [`${t.late} late answers, ${t.overrun} overruns, worst lateness ${number(t.worst, 3)} µs, work ${number(t.work, 3)} µs`] : []),
  ].join(" · ");
  if (!t) return;
  const most = Math.max(...t.counts, 1), bars = text("div", "", { className: "histogram" });
  t.counts.forEach((n, i) => {
    const bar = text("i", "", { title: `${t.edges[i]} µs and more: ${n}` });
    bar.style.height = `${(100 * Math.log1p(n)) / Math.log1p(most)}%`;
    if (t.edges[i] >= t.deadline) bar.className = "beyond";
    if (t.edges[i] >= t.deadline && !(t.edges[i - 1] >= t.deadline)) bar.className = "beyond deadline";
    bars.append(bar);
  });
  bars.setAttribute("role", "img");
  bars.setAttribute("aria-label", `Histogram of lateness; the deadline is ${number(t.deadline)} µs`);
  run.late.replaceChildren(bars, text("label", `lateness, 0 µs to 50 ms (logarithmic), deadline ${number(t.deadline)} µs`));
}

function showEvents(run) {
  for (const event of run.now.events) {
    run.since = event.number + 1;
    run.events.push(event);
    const item = text("li", "", { className: event.severity });
    const go = text("button", `${number(event.t_s)} s`, { type: "button", title: "go there" });
    go.addEventListener("click", () => view.centre(event.t_s));
    item.append(go, " ", (runs.length > 1 ? `${run.about.name}: ` : "") + event.message);
    $("events").prepend(item);
    while ($("events").childElementCount > 300) $("events").lastChild.remove();
    if (event.severity !== "info" && event.severity !== "debug") say(event.message, true);
  }
}

// The time window that every scope shows: it follows the run, or stays where it was put.
const view = {
  span: 10, end: null, // s; end null: follow
  latest: 0, first: 0,
  follow() { view.end = null; },
  centre(t) { view.put(t + view.length() / 2); },
  put(end) { view.end = Math.min(Math.max(end, view.first), Math.max(view.latest, view.length())); },
  zoom(from, to) { view.span = to - from; view.end = to; $("span").value = ""; },
  length() { return view.span || Math.max(view.latest - view.first, 1e-3); },
  range() { const end = view.end ?? view.latest; return [Math.max(end - view.length(), view.first), end]; },
};

async function picture(run) {
  const period = run.about.period, [from, to] = view.range();
  const words = performance.now() - run.worded > 250;
  if (words) run.worded = performance.now();
  const asked = new URLSearchParams({ side: run.index, since: run.since, columns: Math.min(run.scopes.width(), 1200) });
  if (run.now && run.now.slots) {
    asked.set("first", Math.max(Math.floor(from / period), 0));
    if (view.end !== null) asked.set("end", Math.ceil(to / period));
  }
  if (words) asked.set("words", "1");
  const answer = await fetch(`view?${asked}`, { headers });
  const data = await answer.arrayBuffer(), size = new DataView(data).getUint32(0, true);
  const head = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, size)));
  const before = run.now;
  run.now = { ...before, ...head };
  if (before && head.run !== before.run) return location.reload(); // it was restarted
  run.scopes.show(new Float32Array(data, 4 + size), head.window, period);
  drawDevice(run.canvas, run.about, head.device, run.now.given);
  showEvents(run);
  if (words) showWords(run);
  const outputs = run.about.outputs.map((s) => `${s.name} ${number(head.device[s.name] ?? run.scopes.last(s.name))} ${s.unit}`);
  run.values.textContent = [outputs.join(", "), run.now.given == null ? "" : energyWords(run.now.given)].filter(Boolean).join(" · ");
}

let runs = [], act = null, drawing = false, seconds = 0;
async function frame() {
  try {
    if (!document.hidden) {
      await Promise.all(runs.map(picture));
      const { now, about } = runs[0];
      view.latest = now.slots * about.period;
      view.first = now.first * about.period;
      $("time").textContent = `${(view.end ?? view.latest).toFixed(about.period < 0.01 ? 3 : 2)} s`;
      const first = now.status === "running" && !now.slots; // in real time its processes are starting
      badge($("status"), first ? STATUS.waiting : STATUS[now.status] || STATUS.waiting, first ? "waiting for slot 0" : now.status);
      $("pause").textContent = now.status === "paused" ? "Resume" : "Pause";
      $("follow").setAttribute("aria-pressed", String(view.end === null));
      if (document.activeElement !== $("slider")) $("slider").value = view.latest > view.first ? (1000 * ((view.end ?? view.latest) - view.first)) / (view.latest - view.first) : 1000;
      act?.show(now.draft, runs);
      table.show(runs);
      say(`${number(view.latest, 3)} s, ${now.status}. ${runs.map((r) => `${r.about.name}: ${r.values.textContent}; ${MEANS[r.now.certificate?.state] || ""}`).join(". ")}`);
    }
    document.body.classList.remove("stale");
  } catch (error) {
    if (!(error instanceof TypeError)) console.error(error);
    badge($("status"), STATUS.lost, "server ended");
    document.body.classList.add("stale");
    await new Promise((go) => setTimeout(go, 1000));
  }
  requestAnimationFrame(frame);
}

const table = traceTable($("trigger"), view, () => runs);
const commands = {
  pause: () => wish({ do: runs[0].now.status === "paused" ? "resume" : "pause" }),
  step: () => wish({ do: "step" }),
  speed: () => wish({ do: "speed", speed: +$("speed").value }),
  restart: () => wish({ do: "restart", seed: $("seed").value === "" ? null : +$("seed").value }),
  end: () => wish({ do: "end" }),
  follow: () => view.follow(),
  span: () => { view.span = +$("span").value; },
};
for (const id of ["pause", "step", "restart", "end", "follow"]) $(id).addEventListener("click", commands[id]);
for (const id of ["speed", "span"]) $(id).addEventListener("change", commands[id]);
$("slider").addEventListener("input", () => view.put(view.first + ($("slider").value / 1000) * (view.latest - view.first)));
const KEYS = {
  " ": commands.pause, ".": commands.step, f: commands.follow, a: () => table.cursor(0), b: () => table.cursor(1), m: () => table.bookmark(),
  t: () => table.arm(), ArrowLeft: () => view.put((view.end ?? view.latest) - view.length() / 4),
  ArrowRight: () => view.put((view.end ?? view.latest) + view.length() / 4), "+": () => { view.span = view.length() / 2; },
  "-": () => { view.span = view.length() * 2; }, Enter: () => act?.apply(),
  Escape: () => act?.drop(),
};
const pressed = /^( |Enter)$/; // what a button takes for itself
addEventListener("keydown", (event) => {
  const inside = event.target.closest?.("input, select, button, summary, a")?.tagName, key = event.key;
  const ours = !inside || key === "Escape" || (inside === "INPUT" || inside === "SELECT" ? key === "Enter" : !pressed.test(key));
  if (!KEYS[key] || !ours || event.ctrlKey || event.metaKey || event.altKey) return;
  event.preventDefault();
  KEYS[event.key]();
});

async function begin() {
  const about = await (await fetch("about", { headers })).json();
  if (!about.runs.length || !about.runs.every((r) => r.name)) {
    badge($("status"), STATUS.waiting, about.runs.map((r) => r.waits).filter(Boolean).join("; ") || "waiting");
    return setTimeout(begin, 300);
  }
  $("where").textContent = `hilrig live · ${about.where}${about.acts ? "" : " · read only"}`;
  $("title").textContent = document.title = about.runs.map((r) => r.name).join(" beside ");
  $("seed").value = about.runs[0].seed;
  const acts = about.acts && about.runs[0].controllable;
  $("pace").hidden = $("act-keys").hidden = !acts;
  $("pace-keys").hidden = !acts || !about.runs[0].paced;
  for (const id of ["pause", "step", "speed-of"]) $(id).hidden = !about.runs[0].paced; // in real time the clock on the wall paces
  runs = about.runs.map(makeRun);
  if (acts) act = makeAct($("act"), about.runs, wish, () => runs, async () => (await fetch("controllers", { headers })).json());
  window.hilLive = { runs, view, table, wish }; // for tests
  frame();
}
begin();
