"use strict";
(() => {
  // A table that is searched: rows without the words are hidden; ticked rows are shown in the plots whose curves bear their names.
  for (const table of document.querySelectorAll("table[data-searched]")) {
    const rows = [...table.tBodies[0].rows], chosen = [];
    const search = Object.assign(document.createElement("input"), { type: "search", placeholder: "filter: words of a row" });
    search.setAttribute("aria-label", "filter the rows");
    const count = document.createElement("span");
    count.setAttribute("role", "status");  // who does not see the table hears how many rows are left
    const bar = document.createElement("p");
    bar.className = "search";
    bar.append(search, " ", count);
    table.closest("figure").prepend(bar);
    const filter = () => {
      const words = search.value.toLowerCase().split(/\s+/).filter(Boolean);
      for (const row of rows) row.hidden = !words.every((word) => row.textContent.toLowerCase().includes(word));
      count.textContent = rows.filter((row) => !row.hidden).length + " of " + rows.length;
    };
    search.addEventListener("input", filter);
    filter();

    const head = table.tHead.rows[0];
    const names = rows.map((row) => row.cells[0].textContent);
    const numeric = [...head.cells].map((cell) => cell.classList.contains("number"));
    const differences = document.createElement("p");
    differences.className = "differences";
    differences.setAttribute("aria-live", "polite");
    table.closest("figure").append(differences);
    const value = (row, j) => row.cells[j + 1].dataset.value;  // behind the cell with the tick

    const show = () => {
      for (const plot of hilPlots()) {
        const rows = plot.series.map((series, i) => (i ? names.indexOf(series.label) : -1));
        if (rows.every((row) => row < 0)) continue;
        rows.forEach((row, i) => i && plot.setSeries(i, { show: !chosen.length || chosen.includes(row) }));
        plot.root.closest("figure").hidden = chosen.length > 0 && !rows.some((row) => chosen.includes(row));
      }
      if (chosen.length < 2) return (differences.textContent = "");
      const [a, b] = chosen.map((i) => rows[i]);
      const told = [...numeric.keys()].filter((j) => numeric[j] && value(a, j) && value(b, j)).map((j) =>
        head.cells[j + 1].textContent + " " + +(value(b, j) - value(a, j)).toPrecision(4));
      differences.textContent = names[chosen[1]] + " minus " + names[chosen[0]] + ": " + told.join(", ");
    };
    head.prepend(document.createElement("th"));
    rows.forEach((row, i) => {
      const tick = Object.assign(document.createElement("input"), { type: "checkbox" });
      tick.setAttribute("aria-label", "choose " + names[i]);
      tick.addEventListener("change", () => {
        if (tick.checked) chosen.push(i); else chosen.splice(chosen.indexOf(i), 1);
        show();
      });
      row.insertCell(0).append(tick);
    });
  }
})();
