// Scopes over one time window, the trigger that holds it, cursors with differences, and bookmarks.
import { number, text } from "./live.js";

const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const STEPPED = /mode|age|^d$|tau|row|status/;

export function makeScopes(place, about, view) {
  const panels = new Map();
  about.traces.forEach((trace, i) => {
    if (!panels.has(trace.panel)) panels.set(trace.panel, []);
    panels.get(trace.panel).push({ ...trace, i, colour: panels.get(trace.panel).length });
  });
  const scopes = [...panels].map(([title, traces]) => makeScope(place, title, traces, view));
  const curves = scopes.flatMap((scope) => scope.traces);
  return {
    curves,
    width: () => scopes[0]?.plot.width || 600,
    last: (field) => curves.find((c) => c.field === field)?.last,
    show(data, [first, columns, slots], period) {
      const x = new Float64Array(slots === 1 ? columns : 2 * columns);
      for (let i = 0; i < x.length; i++) x[i] = (first + (slots === 1 ? i : (i / 2) * slots)) * period;
      const [from, to] = view.range();
      for (const scope of scopes) {
        const table = [x];
        for (const trace of scope.traces) {
          const low = data.subarray(2 * trace.i * columns, (2 * trace.i + 1) * columns), high = data.subarray((2 * trace.i + 1) * columns, (2 * trace.i + 2) * columns);
          Object.assign(trace, { low, high, first, slots, period });
          const y = Array.from(x, (_, i) => { const v = slots === 1 ? high[i] : (i % 2 ? high : low)[i >> 1]; return Number.isNaN(v) ? null : v; });
          for (let i = columns - 1; i >= 0; i--) if (!Number.isNaN(high[i])) { trace.last = high[i]; break; }
          table.push(y);
        }
        scope.quiet = true;
        scope.plot.setData(table, false);
        scope.plot.setScale("x", { min: from, max: Math.max(to, from + 1e-6) });
        scope.quiet = false;
      }
    },
  };
}

function makeScope(place, title, traces, view) {
  const panel = text("figure", "", { className: "panel scope" });
  panel.append(text("h3", title + (traces[0].unit === "1" || title.includes(",") ? "" : `, ${traces[0].unit}`)));
  const at = document.createElement("div");
  panel.append(at);
  place.append(panel);
  const scope = { traces, quiet: false, title };
  const name = (trace) => (trace.topic === "/reference" ? `reference ${trace.field}` :
    trace.topic === "/actuator/applied" && trace.field.startsWith("w_") ? `disturbance ${trace.field.slice(2)}` : traces.filter((t) => t.field === trace.field).length > 1 ?
    `${trace.field} ${trace.topic === "/network/sc" ? "to the controller" : trace.topic === "/network/ca" ? "to the actuator" : trace.topic === "/plant/measurement" ? "measured" : ""}`.trim() : trace.field);
  traces.forEach((trace) => { trace.label = name(trace); trace.title = title; });
  const axis = (size) => ({ stroke: () => css("--muted"), grid: { stroke: () => css("--line-soft"), width: 1 }, ticks: { stroke: () => css("--line") }, size,
    values: (u, splits) => splits.map((v) => (v == null ? "" : number(v, 7))) });
  const stepped = uPlot.paths.stepped({ align: 1 });
  scope.plot = new uPlot({
    width: at.clientWidth || 600, height: 150, ms: 1,
    legend: { live: true },
    cursor: { y: false, drag: { x: true, y: false, setScale: false }, sync: { key: "live" } },
    scales: { x: { time: false }, y: { range: (u, low, high) => {
      if (low == null) return [0, 1];
      const size = Math.max(Math.abs(low), Math.abs(high)), room = (high - low > 1e-5 * size ? high - low : size || 1) * 0.07;
      return [low - room, high + room];
    } } },
    axes: [axis(26), axis(66)],
    series: [{ label: "t, s", value: (u, v) => number(v, 5) }, ...traces.map((trace) => ({
      label: trace.label, stroke: () => css(`--c${trace.colour}`), width: 1.6, points: { show: false }, spanGaps: true,
      dash: trace.topic === "/reference" ? [6, 4] : undefined, value: (u, v) => number(v),
      paths: (u, ...rest) => (trace.slots === 1 && (STEPPED.test(trace.field) || /reference|applied/.test(trace.topic)) ? stepped : uPlot.paths.linear())(u, ...rest),
    }))],
    hooks: {
      setSelect: [(u) => {
        if (u.select.width > 4) view.zoom(u.posToVal(u.select.left, "x"), u.posToVal(u.select.left + u.select.width, "x"));
        u.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
      }],
      setCursor: [(u) => { if (u.cursor.left >= 0) view.pointer = u.posToVal(u.cursor.left, "x"); }],
      draw: [(u) => marks(u, view)],
    },
  }, [[0], ...traces.map(() => [null])], at);
  scope.plot.ctx.canvas.setAttribute("role", "img");
  scope.plot.ctx.canvas.setAttribute("aria-label", `${title} over time: ${traces.map((trace) => trace.label).join(", ")}`);
  at.addEventListener("dblclick", () => { view.follow(); });
  new ResizeObserver(() => { if (at.clientWidth && at.clientWidth !== scope.plot.width) scope.plot.setSize({ width: at.clientWidth, height: 150 }); }).observe(at);
  return scope;
}

function marks(u, view) {
  const { ctx } = u, { left, top, width, height } = u.bbox;
  ctx.save();
  ctx.lineWidth = devicePixelRatio;
  ctx.font = `${11 * devicePixelRatio}px ${css("--sans")}`;
  for (const [t, label, colour] of [[view.cursors?.[0], "a", "--c4"], [view.cursors?.[1], "b", "--c5"], [view.triggered, "trigger", "--bad"]]) {
    const x = t == null ? -1 : u.valToPos(t, "x", true);
    if (x < left || x > left + width) continue;
    ctx.strokeStyle = ctx.fillStyle = css(colour);
    ctx.setLineDash(label === "b" ? [5, 4] : []);
    ctx.beginPath();
    ctx.moveTo(x, top);
    ctx.lineTo(x, top + height);
    ctx.stroke();
    ctx.fillText(label, x + 4, top + 12 * devicePixelRatio);
  }
  ctx.restore();
}

const valueAt = (c, t) => c.high?.[Math.floor((t / c.period - c.first) / c.slots + 1e-6)];

// Trigger, cursors and bookmarks of all runs, and the panel that shows them.
export function traceTable(place, view, runs) {
  const source = document.createElement("select"), level = Object.assign(document.createElement("input"), { type: "number", step: "any", value: "0" });
  const edge = document.createElement("select"), before = Object.assign(document.createElement("input"), { type: "number", min: 0, max: 100, value: 20 });
  const armed = text("button", "Arm (t)", { type: "button" }), message = text("p", "", { className: "intro" });
  const differences = text("table", "", { className: "measured" }), bookmarks = text("div", "", { className: "row" });
  for (const [value, words] of [["up", "rises above"], ["down", "falls below"]]) edge.append(text("option", words, { value }));
  for (const [element, label] of [[source, "Trigger on"], [edge, "Edge"], [level, "Level"], [before, "Pre-trigger, percent of the window"]]) element.setAttribute("aria-label", label);
  const line = text("div", "", { className: "row" }), second = text("div", "", { className: "row" });
  line.append(source, edge, level);
  second.append(text("label", "pre-trigger %"), before, armed);
  const row = text("div", "", { className: "row" });
  const buttons = [["Cursor a", () => self.cursor(0)], ["Cursor b", () => self.cursor(1)], ["Bookmark", () => self.bookmark()]];
  for (const [words, act] of buttons) { const b = text("button", words, { type: "button" }); b.addEventListener("click", act); row.append(b); }
  place.append(text("h2", "Trigger and cursors"), line, second, message, row, differences, bookmarks);
  let state = "off", seen = 0, eventsSeen = 0, shown = "";
  view.cursors = [null, null];

  const self = {
    arm() {
      state = state === "off" ? "armed" : "off";
      const run = runs()[0];
      seen = run.now.slots;
      eventsSeen = run.since;
      if (state === "armed") { view.triggered = null; view.follow(); }
    },
    cursor(i) { view.cursors[i] = view.pointer ?? (view.range()[0] + view.range()[1]) / 2; },
    bookmark() {
      const t = view.pointer ?? view.end ?? view.latest, go = text("button", `${number(t)} s`, { type: "button", title: "bookmark" });
      go.addEventListener("click", () => view.centre(t));
      bookmarks.append(go);
    },
    triggered: () => view.triggered,
    show(all) {
      fill(all[0]);
      if (state === "armed") look(all[0]);
      const hold = view.triggered != null && state === "held";
      armed.textContent = { off: "Arm (t)", armed: "Armed …", held: "Triggered: release (t)" }[state];
      armed.setAttribute("aria-pressed", String(state !== "off"));
      message.textContent = hold ? `triggered at ${number(view.triggered, 6)} s` : "";
      measure(all);
    },
  };
  armed.addEventListener("click", () => self.arm());

  function fill(run) {
    if (source.childElementCount) return;
    run.scopes.curves.forEach((c, i) => source.append(text("option", `${c.title}: ${c.label}`, { value: String(i) })));
    source.append(text("option", "any event", { value: "event" }), text("option", "a late answer", { value: "late" }));
  }
  function look(run) {
    const at = source.value === "event" || source.value === "late" ? ofEvents(run) : crossing(run.scopes.curves[+source.value]);
    seen = run.now.slots;
    if (at == null) return;
    state = "held";
    view.triggered = at;
    view.end = at + (1 - before.value / 100) * view.length();
  }
  function ofEvents(run) {
    const found = run.events.find((e) => e.number >= eventsSeen && (source.value === "event" || /late|no control packet/.test(e.kind + e.message)));
    return found?.t_s ?? null;
  }
  function crossing(c) {
    if (!c?.high) return null;
    const up = edge.value === "up", over = (v) => (up ? v >= +level.value : v <= +level.value);
    const begin = Math.max(Math.floor((seen - c.first) / c.slots), 0);
    for (let i = begin; i < c.high.length; i++) {
      const was = i ? (up ? c.low : c.high)[i - 1] : NaN, extreme = (up ? c.high : c.low)[i], rest = (up ? c.low : c.high)[i];
      if (over(extreme) && (!over(rest) || (!Number.isNaN(was) && !over(was)))) return (c.first + i * c.slots) * c.period;
    }
    return null;
  }
  function measure(all) {
    const [a, b] = view.cursors, key = JSON.stringify([a, b, all[0].now.slots >> 3]);
    if ((a == null && b == null) || key === shown) return;
    shown = key;
    const head = document.createElement("tr");
    for (const words of ["", "a", "b", "b − a"]) head.append(text("th", words));
    const rows = [head, cells("t, s", a, b, (t) => t)];
    for (const run of all) for (const c of run.scopes.curves) rows.push(cells((all.length > 1 ? `${run.about.name} ` : "") + `${c.label}`, a, b, (t) => valueAt(c, t)));
    differences.replaceChildren(...rows);
  }
  function cells(name, a, b, of) {
    const row = document.createElement("tr"), va = a == null ? null : of(a), vb = b == null ? null : of(b);
    row.append(text("th", name), text("td", number(va)), text("td", number(vb)), text("td", va == null || vb == null ? "" : number(vb - va)));
    return row;
  }
  return self;
}
