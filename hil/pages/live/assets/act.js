// What may be changed: each change is checked first, shown with the certificate of the loop that would run, then applied.
import { claimBadge, number, text } from "./live.js";

export function makeAct(place, abouts, wish, runs, controllersOf) {
  const about = abouts[0], drafts = { pending: null };
  place.hidden = false;
  const heading = text("h2", "Changes");
  const draft = text("div", "", { className: "draft", ariaLive: "polite" });
  const undo = text("div", "", { className: "row" });
  place.append(heading, draft, undo);

  const check = (path, value) => { drafts.pending = { path, value }; return wish({ do: "check", path, value }); };
  const apply = (path, value) => wish({ do: "apply", path, value });
  const button = (words, act, attributes = {}) => {
    const made = text("button", words, { type: "button", ...attributes });
    made.addEventListener("click", act);
    return made;
  };
  const input = (label, value, attributes = {}) => {
    const made = Object.assign(document.createElement("input"), { type: "number", step: "any", value, ...attributes });
    made.setAttribute("aria-label", label);
    return made;
  };
  const field = (title, ...parts) => {
    const set = document.createElement("fieldset");
    set.append(text("legend", title), ...parts);
    place.append(set);
    return set;
  };
  const row = (...parts) => { const made = text("div", "", { className: "row" }); made.append(...parts); return made; };

  // Reference: a slider or a number for each output, where the loop follows one.
  const wanted = about.outputs.map(() => 0), follow = [];
  if (about.traces.some((trace) => trace.topic === "/reference")) field("Reference", ...about.outputs.map((s, i) => {
    const box = input(`reference of ${s.name}, ${s.unit}`, 0), slide = Object.assign(document.createElement("input"), { type: "range", min: -5, max: 5, step: 0.05, value: 0 });
    slide.setAttribute("aria-label", `drag the reference of ${s.name}`);
    const set = (v) => { wanted[i] = +v; box.value = slide.value = v; };
    slide.addEventListener("input", () => set(slide.value));
    let seen;
    follow.push((v) => { // where the reference is, also where the run's own changes put it; no hand is on it
      if (v == null || v === seen || slide.matches(":active") || document.activeElement === box) return;
      seen = v;
      set(v);
    });
    const go = () => apply("reference", wanted);
    slide.addEventListener("change", go);
    box.addEventListener("change", () => { slide.max = Math.max(slide.max, 1.5 * Math.abs(box.value)); slide.min = -slide.max; set(box.value); go(); });
    box.addEventListener("keydown", (event) => event.key === "Enter" && event.stopPropagation()); // it makes a change event of it
    return row(text("label", `${s.name}, ${s.unit}`), slide, box);
  }));

  // Disturbance: a pulse on the input.
  const size = input(`disturbance, ${about.inputs[0].unit}`, 0.2), slots = input("slots", 2, { min: 1, step: 1 });
  field("Disturbance on the input", row(size, text("label", about.inputs[0].unit), slots, text("label", "slots"), button("Push", () =>
    apply("disturbance", { value: about.inputs.map(() => +size.value), samples: Math.max(1, Math.round(+slots.value)) }), { id: "push" })));

  // Network: presets, two sliders, and the chain as a heat map, in each direction.
  const direction = document.createElement("select");
  direction.setAttribute("aria-label", "Direction");
  direction.append(...Object.entries(about.network).map(([value, { label }]) => text("option", label, { value })));
  const preset = document.createElement("select"), heat = text("table", "", { className: "heat" });
  preset.setAttribute("aria-label", "Preset");
  const loss = Object.assign(document.createElement("input"), { type: "range", min: 0, max: 0.9, step: 0.02, value: 0 });
  const delay = Object.assign(document.createElement("input"), { type: "range", min: 0, max: 1, step: 0.05, value: 0 });
  loss.setAttribute("aria-label", "Loss, share of packets");
  delay.setAttribute("aria-label", "Delay, share of the longest");
  const checkMatrix = row(button("Check the matrix", () => check(path(), { kind: "markov", matrix: entries() }), { id: "check-matrix" }));
  const lossLabel = text("label", "loss"), delayLabel = text("label", "delay"); // numbers of a law that is set here
  const laws = () => about.network[direction.value], acting = {}; // of each direction, the law that a change put there
  const alike = (a, b) => JSON.stringify(a) === JSON.stringify(b);
  const matrix = (law) => !law || alike(law, laws().law) ? laws().chain : law.matrix || null;
  function offer() {
    preset.replaceChildren(text("option", "preset …", { value: "" }), text("option", "as it was", { value: "as it was" }), ...Object.keys(laws().presets).map((name) => text("option", name, { value: name })));
    chain(matrix(acting[direction.value]));
  }
  function act(name, law) { // a change from this tab or another one; what is being edited here stays
    if (acting[name] === law) return;
    acting[name] = law;
    const edited = heat.contains(document.activeElement) || drafts.pending?.path === path() || alike(entries(), law.matrix);
    if (name === direction.value && !edited) offer();
  }
  function chain(matrix) {
    heat.replaceChildren();
    checkMatrix.hidden = !matrix;
    if (!matrix) return heat.append(text("caption", "this law has no matrix"));
    matrix.forEach((line, i) => {
      const tr = document.createElement("tr");
      line.forEach((p, j) => {
        const td = document.createElement("td"), box = input(`probability of mode ${j} after ${i}`, number(p, 3).replace("−", "-"), { min: 0, max: 1, step: 0.05 });
        td.style.setProperty("--shade", p);
        box.addEventListener("input", () => td.style.setProperty("--shade", +box.value || 0));
        td.append(box);
        tr.append(td);
      });
      heat.append(tr);
    });
  }
  const entries = () => [...heat.rows].map((tr) => [...tr.querySelectorAll("input")].map((box) => +box.value));
  const path = () => `network.${direction.value}.law`;
  direction.addEventListener("change", offer);
  preset.addEventListener("change", () => {
    const law = preset.value === "as it was" ? laws().law : laws().presets[preset.value];
    if (!law) return;
    chain(law.matrix || null);
    check(path(), law);
  });
  const sliders = () => {
    const ms = 1e3 * about.period * (laws().longest || 1) * +delay.value;
    lossLabel.textContent = `loss ${Math.round(100 * loss.value)} %`;
    delayLabel.textContent = `delay ${number(+delay.value * (laws().longest || 1), 3)} samples`;
    return { kind: "packet", latency: `${ms.toFixed(3)} ms`, loss: +loss.value };
  };
  for (const slide of [loss, delay]) { slide.addEventListener("input", sliders); slide.addEventListener("change", () => check(path(), sliders())); }
  if (direction.length) {
    field("Network", row(direction, preset), row(lossLabel, loss), row(delayLabel, delay), heat, checkMatrix);
    offer();
  }

  // Controller: any that a shipped experiment has for the same plant.
  const controller = document.createElement("select");
  controller.setAttribute("aria-label", "Controller");
  const others = field("Controller", row(controller));
  others.hidden = true;
  controllersOf().then((found) => {  // which load every shipped experiment: the page does not wait for them
    controller.append(text("option", "another controller …", { value: "" }), ...Object.keys(found).map((name) => text("option", name, { value: name })));
    controller.addEventListener("change", () => controller.value && check("controller", found[controller.value]));
    others.hidden = !Object.keys(found).length;
  });

  // Plant: the numbers that may change while it runs.
  const paths = Object.keys(about.fields);
  if (paths.length) {
    const name = document.createElement("select"), value = input("value of the plant's field", about.fields[paths[0]]);
    name.setAttribute("aria-label", "Field of the plant");
    name.append(...paths.map((path) => text("option", path.replace("plant.", ""), { value: path })));
    name.addEventListener("change", () => { value.value = about.fields[name.value]; });
    field("Plant", row(name, value, button("Check", () => check(name.value, +value.value), { id: "check-plant" })));
  }

  // Faults.
  const lasts = input("seconds that a fault lasts", number(Math.max(4 * about.period, 0.1), 2), { min: 0 });
  const fault = (words, kind, link) => button(words, () => check("fault", { kind, for: +lasts.value, ...(link ? { link } : {}) }));
  field("Faults", row(text("label", "for"), lasts, text("label", "s")), row(fault("Cut to controller", "cut", "sc"), fault("Cut to actuator", "cut", "ca"),
    fault("Flip bits", "corrupt", "sc"), fault("Freeze", "freeze", "sc"), fault(about.paced ? "Restart the controller" : "Kill and restart the controller", "controller-restart")));

  const table = text("table", "", { className: "measured" });
  const link = text("a", "the script of this run", { href: "script", download: "changes.jsonl" });
  field("Changed", table, row(link));
  let back = null; // the button that asked by keyboard: the focus goes to Apply, and comes back
  const done = () => { drafts.pending = null; back?.focus(); back = null; };
  const self = {
    apply() { if (drafts.pending) { apply(drafts.pending.path, drafts.pending.value); done(); } },
    drop() { if (drafts.pending) { done(); draft.replaceChildren(text("p", "dropped")); } },
    show(now, all) {
      about.outputs.forEach((s, i) => follow[i]?.(all[0].scopes.curves.find((c) => c.topic === "/reference" && c.field === s.name)?.last));
      const key = JSON.stringify([now, all[0].now.changes]);
      if (key === self.shown) return;
      self.shown = key;
      const worst = now.claims.some((c) => c.state === "refused") ? "bad" : now.claims.some((c) => c.state !== "certified") ? "warning" : "good";
      draft.className = `draft ${now.state === "refused" ? "bad" : now.state === "ready" || now.state === "armed" ? worst : ""}`;
      const heads = { none: "Change something: its certificate comes first.", computing: `${now.path}: computing the certificate …`, ready: `${now.path}: the loop that would run is`, refused: now.message, armed: `${now.path}: ${now.message}` };
      draft.replaceChildren(text("p", heads[now.state]));
      for (const claim of now.claims) {
        const line = document.createElement("p"), at = document.createElement("span");
        claimBadge(at, claim);
        line.append(at, text("span", ` ${now.claims.length > 1 ? `${claim.run || ""}: ` : ""}${claim.reason || ""}`));
        draft.append(line);
      }
      if (now.state === "ready" && drafts.pending) {
        const yes = button("Apply (enter)", self.apply, { className: "go", id: "apply" }), on = document.activeElement;
        draft.append(row(yes, button("Drop (esc)", self.drop)));
        if (place.contains(on) && on.matches("button:focus-visible")) { back ??= on; yes.focus(); }
      }
      changes(all[0]);
    },
  };
  function changes(run) {
    const newest = new Map();
    for (const event of run.events) if (event.kind === "change" && event.data.path !== "end") newest.set(event.data.path, event.data.value);
    table.replaceChildren(...[...newest].map(([name, value]) => {
      const tr = document.createElement("tr");
      tr.append(text("th", name), text("td", JSON.stringify(value).slice(0, 60)));
      return tr;
    }));
    const own = { controller: about.own };
    for (const [name, { law }] of Object.entries(about.network)) {
      const at = `network.${name}.law`;
      own[at] = law;
      if (newest.has(at)) act(name, newest.get(at));
    }
    const back = [...newest.keys()].filter((name) => own[name]);
    undo.replaceChildren(...(back.length ? [button("Revert network and controller", () => back.forEach((name) => apply(name, own[name])), { id: "revert" })] : []));
  }
  return self;
}
