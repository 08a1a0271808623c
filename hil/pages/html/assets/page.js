"use strict";
(() => {
  const data = JSON.parse(document.getElementById("hil-data").textContent);
  const arrays = data.arrays.map(({ t, d }) => {
    const raw = Uint8Array.from(atob(d), (c) => c.charCodeAt(0)).buffer;
    if (t === "i2") return Array.from(new Int16Array(raw), (v) => (v === -32768 ? null : v));
    return Array.from(t === "f4" ? new Float32Array(raw) : new Float64Array(raw), (v) => (Number.isNaN(v) ? null : v));
  });
  const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const font = (px) => px + "px " + css("--sans");
  const ROUND = [];
  for (let e = -9; e <= 9; e++) for (const m of [1, 2, 5]) ROUND.push(+(m + "e" + e));
  const plots = [];
  const groups = new Map();
  const reset = document.getElementById("reset");

  function format(value) {
    if (value == null) return "–";
    const size = Math.abs(value);
    const text = size !== 0 && (size < 1e-4 || size >= 1e7) ? value.toExponential(3) : String(+value.toPrecision(5));
    return text.replace(/-/g, "−");
  }

  function aligned(figure) {
    // uPlot wants one x per plot: curves that share x share a table, tables are joined without making gaps.
    const curves = [];
    for (const b of figure.bands)
      for (const edge of ["upper", "lower"]) curves.push({ ...b, y: b[edge], style: "edge", band: edge, label: b.label });
    for (const s of figure.series) curves.push(s);
    const tables = new Map();
    for (const c of curves) {
      if (!tables.has(c.x)) tables.set(c.x, []);
      tables.get(c.x).push(c);
    }
    const order = [...tables.values()].flat();
    const joined = [...tables].map(([x, list]) => [arrays[x], ...list.map((c) => arrays[c.y])]);
    return { curves: order, table: joined.length === 1 ? joined[0] : uPlot.join(joined) };
  }

  // Where there is no room for all labels, the worst get theirs; the sort is stable, so equals go from left to right.
  const SEVERITY = ["bad", "warning", "good", "neutral"];
  const bySeverity = (list) => [...list].sort((a, b) => SEVERITY.indexOf(a.state) - SEVERITY.indexOf(b.state));

  function markers(figure, withLabels) {
    return {
      hooks: {
        draw: (u) => {
          const { ctx } = u, { left, top, width, height } = u.bbox, dpr = devicePixelRatio || 1;
          ctx.save();
          ctx.beginPath();
          ctx.rect(left, top - 18 * dpr, width, height + 18 * dpr);
          ctx.clip();
          ctx.font = font(10.5 * dpr);
          ctx.textAlign = "left";
          ctx.textBaseline = "bottom";
          const places = bySeverity(figure.markers).map((m) => [m, Math.round(u.valToPos(m.x, "x", true)) + 0.5]);
          const shown = places.filter(([, x]) => x >= left && x <= left + width), taken = [];
          for (const [m, x] of [...shown].reverse()) {
            ctx.strokeStyle = css(m.state === "neutral" ? "--muted" : "--" + m.state);
            ctx.globalAlpha = 0.8;
            ctx.lineWidth = m.label ? dpr : 1.5 * dpr;
            ctx.setLineDash(m.label ? [4 * dpr, 3 * dpr] : []);
            ctx.beginPath();
            // Without a label: one of many, a tick on the upper edge.
            ctx.moveTo(x, top);
            ctx.lineTo(x, top + (m.label ? height : 8 * dpr));
            ctx.stroke();
          }
          ctx.globalAlpha = 1;
          for (const [m, x] of shown.filter(([m]) => withLabels && m.label)) {
            const wide = ctx.measureText(m.label).width;
            const at = Math.min(x - 2 * dpr, left + width - wide), end = at + wide + 8 * dpr;
            if (taken.some(([from, to]) => at < to && from < end)) continue;
            taken.push([at, end]);
            ctx.fillStyle = css(m.state === "neutral" ? "--muted" : "--" + m.state);
            ctx.fillText(m.label, at, top - 3 * dpr);
          }
          ctx.restore();
        },
      },
    };
  }

  const held = (style) => style.endsWith("step");

  function nearest(u, i, index, x, style) {
    const column = u.data[i];
    if (column[index] != null && !(held(style) && u.data[0][index] > x)) return index;
    let low = index, high = index;
    while (low >= 0 && (column[low] == null || (held(style) && u.data[0][low] > x))) low--;
    if (held(style)) return low < 0 ? null : low;
    while (high < column.length && column[high] == null) high++;
    if (low < 0 && high >= column.length) return null;
    if (low < 0) return high;
    if (high >= column.length) return low;
    return x - u.data[0][low] < u.data[0][high] - x ? low : high;
  }

  function curve(c) {
    const colour = "--c" + c.colour;
    const s = {
      label: c.label,
      stroke: () => css(colour),
      width: c.halo ? 5 : c.faint ? 0.8 : 1.6,
      alpha: c.halo ? 0.4 : c.faint ? 0.35 : 1,
      points: { show: false },
      value: (u, v) => format(v),
      class: c.halo ? "of-halo" : "of-" + c.style,
    };
    if (c.style.endsWith("step")) s.paths = uPlot.paths.stepped({ align: 1 });
    if (c.style.startsWith("dashed")) s.dash = [6, 4];
    const single = arrays[c.y ?? c.upper].length === 1;
    if (c.style === "points" || (single && c.style !== "edge")) {
      s.paths = () => null;
      s.points = { show: true, size: 5, width: 0, fill: () => css(colour), stroke: () => css(colour) };
    }
    if (c.style === "circles") {
      s.paths = () => null;
      s.points = { show: true, size: 8, width: 1.6, fill: () => css("--surface"), stroke: () => css(colour) };
    }
    if (c.marked) {
      s.width = 1;
      s.points = { show: true, size: 7, width: 0, fill: () => css(colour), stroke: () => css(colour) };
    }
    if (c.style === "edge") s.width = 0;
    return s;
  }

  // A tick is a round number: all of its digits tell it from its neighbours, and no nought is added, 1.5e−7.
  const tick = (value) => {
    const round = +value.toPrecision(12), size = Math.abs(round);
    return (size !== 0 && (size < 1e-4 || size >= 1e7) ? round.toExponential() : String(round)).replace(/-/g, "−");
  };

  // As wide as its numbers need beside the label, and no narrower than the plots above and below.
  const fits = (least) => (u, values) => {
    if (values == null) return least;
    u.ctx.font = font(11 * uPlot.pxRatio);
    return Math.max(least, Math.ceil(33 + Math.max(...values.map((v) => u.ctx.measureText(v || "").width)) / uPlot.pxRatio));
  };

  function axis(label, size, extra) {
    return {
      label, labelSize: 19, labelGap: 0, size, gap: 5, labelFont: font(11.5), font: font(11),
      stroke: () => css("--muted"),
      grid: { stroke: () => css("--line-soft"), width: 1 },
      ticks: { stroke: () => css("--line"), width: 1, size: 5 },
      values: (u, splits) => splits.map((v) => (v == null ? null : tick(v))),
      ...extra,
    };
  }

  // A run of one sample has an empty range of time, which no scale can show.
  const widened = (low, high) => (low < high ? [low, high] : [low - 0.5, high + 0.5]);

  function span(group) {
    let low = Infinity, high = -Infinity;
    for (const figure of data.figures)
      if (figure.sync === group)
        for (const c of [...figure.series, ...figure.bands]) {
          const x = arrays[c.x];
          if (x.length) { low = Math.min(low, x[0]); high = Math.max(high, x[x.length - 1]); }
        }
    return low <= high ? widened(low, high) : null;
  }

  function build(place) {
    const figure = data.figures[+place.dataset.figure];
    const { curves, table } = aligned(figure);
    const group = figure.sync;
    if (group != null && !groups.has(group)) groups.set(group, { plots: [], range: span(group), zoomed: false });
    const peers = group != null ? groups.get(group) : { plots: [], range: null, zoomed: false };
    const first = peers.plots.length === 0;
    const labelled = figure.markers.some((m) => m.label) && (first || group == null);
    const bands = [];
    curves.forEach((c, i) => {
      if (c.band !== "upper") return;
      const lower = curves.findIndex((o) => o.band === "lower" && o.label === c.label && o.x === c.x && o.colour === c.colour);
      bands.push({ series: [i + 1, lower + 1], fill: () => css("--c" + c.colour) + "2e" });
    });
    const options = {
      width: place.clientWidth || 800,
      height: figure.height,
      padding: [labelled ? 18 : 8, 18, 0, 0],
      legend: {
        live: true,
        markers: { width: 0, fill: (u, i) => (i ? `var(--c${curves[i - 1].colour})` : "transparent") },
      },
      cursor: {
        y: false,
        drag: { x: true, y: false, setScale: true },
        points: { size: 7, width: 0 },
        dataIdx: (u, i, index, x) => (i === 0 ? index : nearest(u, i, index, x, curves[i - 1].style)),
        sync: group == null ? undefined : {
          key: group, scales: ["x", null],
          filters: { pub: (type) => type === "mousemove" || type === "mouseleave", sub: (type) => type === "mousemove" || type === "mouseleave" },
        },
        bind: { dblclick: () => () => { home(peers); return null; } },
      },
      scales: {
        x: { time: false, ...distribution(figure.xLog, figure.xAsinh), range: figure.xLog ? undefined : (u, low, high) => (low == null ? [0, 1] : widened(low, high)) },
        y: { ...distribution(figure.yLog, figure.yAsinh), range: figure.yRange ? () => figure.yRange : figure.yLog ? undefined : (u, low, high) => fitted(low, high, figure.integerY, figure.yAsinh) },
      },
      axes: [
        axis(figure.xLabel, 27, figure.xTicks ? { splits: () => figure.xTicks } : figure.xAsinh ? { splits: signed } : figure.xLog ? {} : { incrs: ROUND }),
        axis(figure.yLabel, fits(62), figure.yAsinh ? { splits: signed } : figure.integerY ? { incrs: [1, 2, 5, 10, 20, 50, 100], space: 18, ...named(figure.yNames) } : {}),
      ],
      series: [{ label: figure.xLabel, value: (u, v) => format(v) }, ...curves.map(curve)],
      bands,
      plugins: [markers(figure, labelled)],
      hooks: {
        setScale: [(u, key) => {
          if (key !== "x" || peers.moving) return;
          peers.moving = true;
          const { min, max } = u.scales.x;
          for (const other of peers.plots) if (other !== u) other.setScale("x", { min, max });
          peers.moving = false;
          if (u.ready) { peers.zoomed = true; show(); }
        }],
      },
    };
    if (figure.xLog) options.scales.x.range = undefined;
    const plot = new uPlot(options, table, place);
    if (peers.range) plot.setScale("x", { min: peers.range[0], max: peers.range[1] });
    else peers.range = widened(table[0][0], table[0][table[0].length - 1]);
    peers.plots.push(plot);
    if (group == null) groups.set(plot, peers);
    plots.push(plot);
    hilSaveCurves(place, figure, curves, table, plot, +place.dataset.figure);
    for (const th of place.querySelectorAll(".u-legend .u-series th")) {
      th.tabIndex = 0;
      th.addEventListener("keydown", (e) => { if (e.key === "Enter" || e.key === " ") { e.preventDefault(); th.click(); } });
    }
    const seen = new Set();
    place.querySelectorAll(".u-legend .u-series").forEach((row, i) => {
      if (!i) return row.classList.add("of-x");
      const c = curves[i - 1];
      // Of a pale bundle, and of a band's two edges, one entry is enough.
      if ((c.faint || c.style === "edge") && seen.has(c.label)) row.classList.add("quiet");
      seen.add(c.label);
    });
    new ResizeObserver(() => {
      if (!document.documentElement.classList.contains("paper") && place.clientWidth > 0 && place.clientWidth !== plot.width)
        plot.setSize({ width: place.clientWidth, height: figure.height });
    }).observe(place);
  }

  const distribution = (log, asinh) => (asinh ? { distr: 4, asinh } : { distr: log ? 3 : 1 });

  // Powers of ten on both sides of 0, from the size on up to which the axis is linear; at most some eight of them.
  function signed(u, index, low, high) {
    const from = Math.floor(Math.log10(u.scales[u.axes[index].scale].asinh)), to = Math.ceil(Math.log10(Math.max(-low, high)));
    const step = Math.max(1, Math.ceil((to - from) * (low < 0 && high > 0 ? 2 : 1) / 8)), found = [0];
    for (let e = from + 1; e <= to; e += step) found.push(10 ** e, -(10 ** e));
    return found.filter((v) => low <= v && v <= high).sort((a, b) => a - b);
  }

  const named = (names) => (names ? { space: 11, values: (u, splits) => splits.map((v) => names[v] ?? "") } : {});

  function fitted(low, high, integer, asinh) {
    if (low == null) return [0, 1];
    if (asinh) {
      const [from, to] = fitted(Math.asinh(low / asinh), Math.asinh(high / asinh));
      return [asinh * Math.sinh(from), asinh * Math.sinh(to)];
    }
    if (integer && low > 0 && low < 10) low = 0;
    if (integer) return [Math.floor(low) - 0.25, Math.max(Math.ceil(high), Math.floor(low) + 1) + 0.25];
    const room = (high - low || Math.abs(high) || 1) * 0.06;
    return [low - room, high + room];
  }

  function home(peers) {
    peers.moving = true;
    for (const plot of peers.plots) plot.setScale("x", { min: peers.range[0], max: peers.range[1] });
    peers.moving = false;
    peers.zoomed = false;
    show();
  }
  function show() { reset.hidden = ![...groups.values()].some((g) => g.zoomed); }
  reset.addEventListener("click", () => groups.forEach(home));

  document.querySelectorAll(".plot").forEach(build);
  document.querySelectorAll("figure[data-numbers]").forEach((panel) => hilSaveStill(panel, data.tables[+panel.dataset.numbers]));
  requestAnimationFrame(() => { for (const p of plots) p.ready = true; for (const g of groups.values()) g.zoomed = false; show(); });
  const redraw = () => plots.forEach((p) => p.redraw(false, true));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  const paper = (on) => {
    document.documentElement.classList.toggle("paper", on);
    for (const p of plots) {
      const place = p.root.parentElement;
      const wide = place.closest(".columns-2") ? 310 : 650;
      p.setSize({ width: on ? wide : place.clientWidth, height: on ? 170 : data.figures[+place.dataset.figure].height });
    }
    redraw();
  };
  addEventListener("beforeprint", () => paper(true));
  addEventListener("afterprint", () => paper(false));
  window.hilPlots = () => plots;
})();
