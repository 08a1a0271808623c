"use strict";
// Bars, histograms, maps and heat maps: saved as they are on the screen (SVG, PNG), or all of their numbers (CSV).
const hilSaveStill = (() => {
  const SPACE = "http://www.w3.org/2000/svg", PAD = 12, LINE = 18;
  const KEPT = ["stroke-width", "stroke-dasharray", "stroke-linejoin", "fill-opacity", "stroke-opacity", "opacity",
    "font-family", "font-size", "font-weight"];
  const dot = document.createElement("canvas").getContext("2d", { willReadFrequently: true });

  // Any colour of the page as one that every viewer of SVG knows, and its opacity.
  function plain(colour) {
    if (!colour || colour === "none") return ["none", 1];
    dot.clearRect(0, 0, 1, 1);
    dot.fillStyle = colour;
    dot.fillRect(0, 0, 1, 1);
    const [r, g, b, a] = dot.getImageData(0, 0, 1, 1).data;
    return a ? [`rgb(${r},${g},${b})`, a / 255] : ["none", 1];
  }

  function add(parent, tag, attributes, words) {
    const node = document.createElementNS(SPACE, tag);
    for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
    if (words != null) node.textContent = words;
    parent.append(node);
    return node;
  }

  function word(parent, from, x, y, anchor, words) {
    const style = getComputedStyle(from);
    return add(parent, "text", { x: x.toFixed(1), y: y.toFixed(1), "text-anchor": anchor, fill: plain(style.color)[0],
      "font-size": style.fontSize, "font-weight": style.fontWeight, "font-family": style.fontFamily }, words);
  }

  // The styles that the page gives by its sheet, written into the drawing itself.
  function styled(svg) {
    const copy = svg.cloneNode(true), theirs = copy.querySelectorAll("*");
    svg.querySelectorAll("*").forEach((node, i) => {
      const style = getComputedStyle(node);
      for (const name of KEPT) theirs[i].setAttribute(name, style.getPropertyValue(name));
      for (const name of ["fill", "stroke"]) {
        const [colour, opacity] = plain(style.getPropertyValue(name));
        theirs[i].setAttribute(name, colour);
        if (opacity < 1) theirs[i].setAttribute(`${name}-opacity`, opacity.toFixed(3));
      }
      theirs[i].removeAttribute("class");
      theirs[i].removeAttribute("style");
    });
    const [, , width, height] = svg.getAttribute("viewBox").split(" ").map(Number);
    const group = document.createElementNS(SPACE, "g");
    group.append(...copy.childNodes);
    return { group, width, height };
  }

  function heatMap(table) {
    const home = table.getBoundingClientRect(), group = document.createElementNS(SPACE, "g");
    for (const cell of table.querySelectorAll("th, td")) {
      const box = cell.getBoundingClientRect(), x = box.left - home.left, y = box.top - home.top;
      const [colour, opacity] = plain(getComputedStyle(cell).backgroundColor);
      if (cell.tagName === "TD")
        add(group, "rect", { x: x.toFixed(1), y: y.toFixed(1), width: box.width.toFixed(1), height: box.height.toFixed(1), rx: 5,
          fill: colour, "fill-opacity": opacity.toFixed(3) });
      const small = cell.querySelector("small"), middle = y + box.height / 2 + (small ? -3 : 4);
      word(group, cell, x + box.width / 2, middle, "middle", cell.firstChild?.nodeType === 3 ? cell.firstChild.data : "");
      if (small) word(group, small, x + box.width / 2, middle + 15, "middle", small.textContent);
    }
    return { group, width: home.width, height: home.height };
  }

  function picture(panel) {
    const svg = panel.querySelector("svg"), { group, width, height } = svg ? styled(svg) : heatMap(panel.querySelector("table"));
    const title = panel.querySelector("h3"), legend = [...panel.querySelectorAll(".legend span")];
    const top = PAD + (title ? LINE : 0) + (legend.length ? LINE : 0), root = document.createElementNS(SPACE, "svg");
    for (const [name, value] of [["width", width + 2 * PAD], ["height", height + top + PAD]]) root.setAttribute(name, value.toFixed(0));
    add(root, "rect", { width: "100%", height: "100%", fill: plain(getComputedStyle(panel).backgroundColor)[0] });
    if (title) word(root, title, PAD, PAD + 10, "start", title.textContent);
    let x = PAD;
    for (const entry of legend) {
      const swatch = entry.querySelector("i"), [colour, opacity] = plain(swatch && getComputedStyle(swatch).backgroundColor);
      add(root, "rect", { x, y: top - 16, width: 11, height: 11, fill: colour, "fill-opacity": opacity.toFixed(3) });
      word(root, entry, x + 17, top - 6, "start", entry.textContent);
      x += entry.getBoundingClientRect().width + 18;
    }
    group.setAttribute("transform", `translate(${PAD} ${top})`);
    root.append(group);
    return { text: new XMLSerializer().serializeToString(root) + "\n", width: width + 2 * PAD, height: height + top + PAD };
  }

  function png(panel, name) {
    const { text, width, height } = picture(panel), image = new Image(), canvas = document.createElement("canvas");
    [canvas.width, canvas.height] = [Math.round(2 * width), Math.round(2 * height)];
    image.onload = () => {
      canvas.getContext("2d").drawImage(image, 0, 0, canvas.width, canvas.height);
      canvas.toBlob((blob) => hilSave.give(name, blob));
    };
    image.src = "data:image/svg+xml;charset=utf-8," + encodeURIComponent(text);
  }

  return (panel, columns) => {
    const base = hilSave.base(panel.querySelector("h3")?.textContent ?? "plot");
    panel.insertBefore(hilSave.buttons({
      SVG: () => hilSave.give(`${base}.svg`, new Blob([picture(panel).text], { type: "image/svg+xml" })),
      PNG: () => png(panel, `${base}.png`),
      CSV: () => hilSave.give(`${base}.csv`, hilSave.csv(columns.map((c) => c.name), columns.map((c) => c.values))),
    }), panel.querySelector("figcaption"));
  };
})();
