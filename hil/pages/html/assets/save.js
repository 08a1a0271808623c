"use strict";
// Every plot can be saved as it is on the screen (SVG, PNG), or with all its numbers (CSV): the buttons, and the file.
const hilSave = (() => {
  const cell = (value) => (value == null ? "" : /[",\n]/.test(value) ? `"${String(value).replace(/"/g, '""')}"` : String(value));

  function csv(names, columns) {
    const rows = [names];
    for (let i = 0; i < columns[0].length; i++) rows.push(columns.map((column) => column[i]));
    return new Blob([rows.map((row) => row.map(cell).join(",")).join("\n") + "\n"], { type: "text/csv" });
  }

  function give(name, blob) {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(blob);
    link.download = name;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  }

  function buttons(ways) {
    const row = document.createElement("div");
    row.className = "save";
    for (const [name, way] of Object.entries(ways)) {
      const button = document.createElement("button");
      button.type = "button";
      button.textContent = name;
      button.title = name === "CSV" ? "Save all numbers of this plot" : `Save this plot as it is now, as ${name}`;
      button.addEventListener("click", way);
      row.append(button);
    }
    return row;
  }

  const base = (what) => `${document.title} ${what}`.replace(/[^A-Za-z0-9._-]+/g, "-").slice(0, 120);
  return { base, buttons, csv, give };
})();
