"use strict";
// The state of the page is its address: every view has a link that restores it.
const VIEWS = { table: "Table", runs: "Runs", overlay: "Overlay", failures: "Failures", run: "Run" };
const DEFAULTS = {
  view: "table", sweep: "", tag: "", metric: "", stage: "", dof: "", model: "",
  sort: "", page: "0", runs: "",
  run: "", deployed: "identified",
};

// { view, ..., filters: Map of factor to a set of levels }
function stateOf(hash) {
  const words = new URLSearchParams(hash.replace(/^#/, ""));
  const state = { ...DEFAULTS, filters: new Map() };
  for (const [name, value] of words) {
    if (name.startsWith("where.")) {
      const factor = name.slice("where.".length);
      if (!state.filters.has(factor)) state.filters.set(factor, new Set());
      state.filters.get(factor).add(value);
    } else if (Object.hasOwn(DEFAULTS, name)) {
      state[name] = value;
    }
  }
  if (!Object.hasOwn(VIEWS, state.view)) state.view = "table";
  return state;
}

function hashOf(state) {
  const words = new URLSearchParams();
  for (const [name, value] of Object.entries(DEFAULTS)) {
    if (state[name] !== value) words.set(name, state[name]);
  }
  for (const [factor, levels] of state.filters) {
    for (const level of levels) words.append(`where.${factor}`, level);
  }
  return `#${words}`;
}

// The condition of --where that selects the same runs; empty if every run is selected.
function conditionOf(runs, filters) {
  const parts = [...filters].filter(([name]) => runs.factors.has(name)).map(([name, levels]) => {
    const factor = runs.factors.get(name);
    const values = [...levels].flatMap((level) =>
      (factor.kinds[factor.levels.indexOf(level)] ?? ["text"]).map((kind) => literal(level, kind)));
    return values.length === 1 ? `${name}=${values[0]}` : `${name} in (${values.join(",")})`;
  });
  return parts.join(" and ");
}

function literal(level, kind) {
  if (kind === "null") return "null";
  return kind === "number" ? level : `"${level.replaceAll('"', '""')}"`;
}

// A command line of seatrial-results, with the words that select the runs of the page.
function commandOf(runs, state, words, selecting = true) {
  const line = [...words];
  if (selecting) {
    const condition = conditionOf(runs, state.filters);
    if (condition) line.push("--where", condition);
    if (state.sweep !== "all" || !state.tag) line.push("--sweep", state.sweep);
    if (state.tag) line.push("--tag", state.tag);
  }
  if (runs.summary.database !== "sqlite:///results/results.db") {
    line.push("--database", runs.summary.database);
  }
  return `${runs.summary.program} ${line.map(shellQuoted).join(" ")}`;
}

// The words of a line, of which short ones are not broken at their hyphens.
function wordsOf(line) {
  return line.split(" ").flatMap((word, i) =>
    [i ? " " : "", word.length < 30 ? element("span", { class: "word" }, word) : word]);
}

// The lines of commands with a button that copies them.
function commandBox(lines) {
  const code = element("code", {}, lines.flatMap((line, i) => [i ? "\n" : "", ...wordsOf(line)]));
  const said = element("span", { role: "status", class: "small" });
  const copy = async () => {
    try {
      await navigator.clipboard.writeText(lines.join("\n"));
      said.textContent = "Copied.";
    } catch { // not allowed here: the text is selected instead
      getSelection().selectAllChildren(code);
      said.textContent = "Selected: copy it with Ctrl+C.";
    }
  };
  return element("div", { class: "command" },
    element("p", {},
      element("button", { type: "button", class: "copy", click: copy }, "Copy as command"), " ", said),
    element("pre", { tabindex: "0", "aria-label": "Command" }, code));
}
