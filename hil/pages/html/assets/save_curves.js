"use strict";
// A plot of curves as it is on the screen, zoom included (SVG, PNG), or with all its numbers (CSV).
const hilSaveCurves = (() => {
  const text = (value) => String(value).replace(/[&<>"]/g, (c) => `&#${c.charCodeAt(0)};`);
  function svg(figure, curves, table, plot) {
    const style = getComputedStyle(document.documentElement), css = (name) => style.getPropertyValue(name).trim();
    const at = (value, key) => plot.valToPos(value, key).toFixed(2), ratio = devicePixelRatio || 1;
    const [left, top, width, height] = ["left", "top", "width", "height"].map((side) => plot.bbox[side] / ratio);
    const { min, max } = plot.scales.x, lines = [], marks = [], legend = [];
    curves.forEach((c, i) => {
      if (!plot.series[i + 1].show) return;
      const column = table[i + 1], colour = text(css("--c" + c.colour)), path = [];
      let last = null, drawn = false, joined = false;
      for (let k = 0; k < column.length; k++) {
        if (column[k] === null) joined = false; // a gap; undefined is only another curve's x
        if (column[k] == null || table[0][k] < min || table[0][k] > max) { if (column[k] != null && table[0][k] < min) last = column[k]; continue; }
        const x = at(table[0][k], "x"), y = at(column[k], "y");
        if (c.style === "points") path.push(`<circle cx="${x}" cy="${y}" r="2.5" fill="${colour}"/>`);
        else if (c.style === "circles") path.push(`<circle cx="${x}" cy="${y}" r="3.5" fill="none" stroke="${colour}" stroke-width="1.4"/>`);
        else path.push(!joined ? `M${x} ${y}` : c.style.endsWith("step") ? `H${x}V${y}` : `L${x} ${y}`);
        if (c.marked) lines.push(`<circle cx="${x}" cy="${y}" r="3" fill="${colour}"/>`);
        drawn = joined = true;
        last = column[k];
      }
      const dash = c.style.startsWith("dashed") ? ' stroke-dasharray="6 4"' : "", alpha = c.halo ? 0.4 : c.faint || c.band ? 0.35 : 1;
      if (c.style === "points" || c.style === "circles") lines.push(path.join(""));
      else if (drawn) lines.push(`<path d="${path.join("")}" fill="none" stroke="${colour}" stroke-width="1.6" opacity="${alpha}"${dash}/>`);
      if (c.band !== "lower" && !legend.some((entry) => entry.label === c.label)) legend.push({ label: c.label, colour });
    });
    for (const m of figure.markers) if (m.label && m.x >= min && m.x <= max)
      marks.push(`<line x1="${at(m.x, "x")}" x2="${at(m.x, "x")}" y1="0" y2="${height}" stroke="#888" stroke-dasharray="4 3"/>`);
    const ticks = [], ink = text(css("--muted"));
    (plot.axes[0]._splits || []).forEach((v, i) => v != null && v >= min && v <= max && ticks.push(
      `<text x="${at(v, "x")}" y="${height + 16}" text-anchor="middle">${text(plot.axes[0]._values[i] ?? "")}</text>`));
    (plot.axes[1]._splits || []).forEach((v, i) => v != null && v >= plot.scales.y.min && v <= plot.scales.y.max && ticks.push(
      `<text x="-6" y="${at(v, "y")}" text-anchor="end" dominant-baseline="middle">${text(plot.axes[1]._values[i] ?? "")}</text>`));
    const entries = legend.map((e, i) => `<text x="${8 + 150 * i}" y="-8" fill="${e.colour}">${text(e.label)}</text>`);
    return `<svg xmlns="http://www.w3.org/2000/svg" width="${left + width + 12}" height="${top + height + 60}" font-family="sans-serif" font-size="11">` +
      `<rect width="100%" height="100%" fill="white"/><g transform="translate(${left} ${top + 20})" fill="${ink}">` +
      `<clipPath id="inside"><rect width="${width}" height="${height}"/></clipPath>` +
      `<rect width="${width}" height="${height}" fill="none" stroke="#ccc"/><g clip-path="url(#inside)">${marks.join("")}${lines.join("")}</g>` +
      `${ticks.join("")}${entries.join("")}<text x="${width / 2}" y="${height + 34}" text-anchor="middle">${text(figure.xLabel)}</text>` +
      `<text transform="translate(-46 ${height / 2}) rotate(-90)" text-anchor="middle">${text(figure.yLabel)}</text></g></svg>\n`;
  }

  return (place, figure, curves, table, plot, number) => {
    const base = hilSave.base(number + 1), names = curves.map((c) => (c.band ? `${c.label}, ${c.band}` : c.label));
    place.append(hilSave.buttons({
      SVG: () => hilSave.give(`${base}.svg`, new Blob([svg(figure, curves, table, plot)], { type: "image/svg+xml" })),
      PNG: () => plot.ctx.canvas.toBlob((blob) => hilSave.give(`${base}.png`, blob)),
      CSV: () => hilSave.give(`${base}.csv`, hilSave.csv([figure.xLabel, ...names], table)),
    }));
  };
})();
