"use strict";
// The list of runs, one run whole, and the failures with their tracebacks.
const PER_PAGE = 100;
const NUMERIC = ["value", "duration"];

const PREFERRED = ["e_pos_mae", "velocity_rmse_free_run", "force_mse"];

// The metric, stage, degree of freedom and model of a state; what it leaves open is chosen here.
function measureOf(summary, state) {
  const { measures } = summary;
  if (!measures.length) return null;
  const preferred = PREFERRED.map((name) => measures.find((one) => one.name === name)).find(Boolean);
  const measure = measures.find((one) => one.name === state.metric) ?? preferred ?? measures[0];
  const asked = [state.stage, state.model, state.dof];
  const parts = measure.parts.filter((part) => asked.every((level, i) => !level || level === part[i]));
  const [stage, model, dof, unit] = parts.find((part) => part[1] === "identified") ?? parts[0] ?? measure.parts[0];
  return { measure, stage, model, dof, unit };
}

// The numbers of a metric for one stage, model and degree of freedom.
async function numbersOf(page, chosen) {
  const parts = await seatrial.load(chosen.measure.script);
  const part = parts.find((one) =>
    one.stage === chosen.stage && one.model === chosen.model && one.dof === chosen.dof);
  return (part?.runs ?? []).flatMap((id, i) => {
    const run = page.runs.byId.get(id);
    return run ? [{ run, value: part.values[i] ?? NaN }] : [];
  });
}

function chosenRuns(state) {
  return state.runs.split(",").filter(Boolean).map(Number);
}

function linkTo(state, changes, ...label) {
  return element("a", { href: hashOf({ ...state, ...changes }) }, ...label);
}

async function runsView(page, state) {
  const { runs } = page;
  const chosen = measureOf(runs.summary, state);
  const numbers = chosen ? await numbersOf(page, chosen) : [];
  const value = new Map(numbers.map((number) => [number.run, number.value]));
  const selected = runs.selected(state);
  const varied = runs.offered().filter((name) => runs.summary.runs.groups.includes(name) || name === "seed");
  const columns = [
    ...(chosen ? [["value", withUnit(`${chosen.measure.label}, ${chosen.dof}`, chosen.unit), (run) => value.get(run)]] : []),
    ["status", "Status", (run) => run.status],
    ...varied.map((name) => [name, inWords(name), (run) => runs.level(run, name)]),
    ["duration", "Duration [s]", (run) => run.duration],
    ["started", "Started (UTC)", (run) => run.started],
  ];
  const by = state.sort.replace(/^-/, "");
  const key = columns.find(([name]) => name === by)?.[2] ?? ((run) => run.id);
  const down = state.sort === "" || state.sort.startsWith("-");
  const list = sorted(selected, key, down);
  const first = Math.min(Number(state.page) || 0, Math.max(0, Math.ceil(list.length / PER_PAGE) - 1));
  const ticked = new Set(chosenRuns(state));
  const row = (run) => element("tr", {},
    element("th", { scope: "row" }, element("label", { class: "level" },
      element("input", { type: "checkbox", id: `tick-${run.id}`, checked: ticked.has(run.id),
        "aria-label": `Overlay run ${run.id}`, change: (event) => tick(page, run.id, event.target.checked) }),
      linkTo(state, { view: "run", run: String(run.id) }, String(run.id)))),
    columns.map(([name, , of]) => runCell(name, of(run))));
  return [
    element("div", { class: "row" }, chosen ? choice("metric", "Metric", runs.summary.measures.map((one) =>
      [one.name, one.label]), chosen.measure.name, (metric) => page.go({ metric })) : null),
    element("p", {}, `${plural(list.length, "run")}; tick runs to overlay them. `,
      ticked.size ? linkTo(state, { view: "overlay" }, `Overlay ${plural(ticked.size, "run")}`) : null),
    scrolling("Runs",
      element("thead", {}, element("tr", {}, sortHeading(page, state, "run", "Run", { class: "label" }),
        columns.map(([name, label]) => sortHeading(page, state, name, label)))),
      element("tbody", { class: "runs" }, list.slice(first * PER_PAGE, (first + 1) * PER_PAGE).map(row))),
    pager(page, first, list.length),
    commandBox([commandOf(runs, state, ["runs", "--limit", String(Math.max(1, list.length))])]),
  ];
}

function tick(page, id, isTicked) {
  const kept = chosenRuns(page.state()).filter((one) => one !== id);
  page.go({ runs: (isTicked ? [...kept, id] : kept).join(",") });
}

function runCell(name, value) {
  if (name === "status") return element("td", { class: "text" }, element("span", { class: `status ${value}` }, value));
  if (NUMERIC.includes(name) && typeof value !== "number") return element("td", {}, "–");
  if (typeof value === "number") return element("td", {}, Number.isNaN(value) ? "–" : numberText(value));
  return element("td", { class: "text" }, value ?? "");
}

function pager(page, at, count) {
  const pages = Math.ceil(count / PER_PAGE);
  if (pages < 2) return null;
  const button = (label, to) => element("button", { type: "button", disabled: to < 0 || to >= pages,
    click: () => page.go({ page: String(to) }) }, label);
  return element("p", { class: "pager" }, button("Previous", at - 1),
    ` Page ${at + 1} of ${pages} `, button("Next", at + 1));
}

async function failuresView(page, state) {
  const failures = await seatrial.load("data/failures.js");
  const selected = new Set(page.runs.selected(state).map((run) => run.id));
  const shown = failures.filter((failure) => selected.has(failure.run));
  const groups = page.runs.summary.runs.groups.filter((name) => page.runs.offered().includes(name));
  return [
    element("h2", {}, plural(shown.length, "failure")),
    shown.map((failure) => {
      const run = page.runs.byId.get(failure.run);
      const choices = groups.map((name) => page.runs.level(run, name));
      return element("details", { class: "failure", id: `failure-${run.id}`, open: state.run === String(run.id) },
        element("summary", {}, element("span", { class: `status ${failure.status}` }, failure.status),
          ` Run ${run.id}: ${[...choices, `seed ${page.runs.level(run, "seed")}`].join(", ")}: `,
          failure.error || "no message"),
        element("p", {}, failure.type ?? "", " ", linkTo(state, { view: "failures", run: String(run.id) }, "Link"),
          " ", linkTo(state, { view: "run", run: String(run.id) }, "Whole run")),
        element("pre", { tabindex: "0" }, element("code", {}, failure.traceback || "no traceback")),
        commandBox([commandOf(page.runs, state, ["show", String(run.id), "--traceback"], false)]));
    }),
    shown.length ? null : element("p", {}, "No run of this selection failed."),
  ];
}

async function runView(page, state) {
  const id = Number(state.run);
  const run = page.runs.byId.get(id);
  if (!run) return [element("p", {}, `There is no run ${state.run}.`)];
  const title = element("h2", {}, `Run ${id}`);
  const command = commandBox([
    commandOf(page.runs, state, ["show", String(id)], false),
    commandOf(page.runs, state, ["show", String(id), "--command"], false),
  ]);
  const overlay = linkTo(state, { view: "overlay", runs: String(id) }, "Track, errors, residuals and coefficients");
  let whole;
  try {
    whole = await seatrial.load(`data/run-${id}.js`);
  } catch {
    return [title, element("p", {}, absent(page, id)), command];
  }
  const text = (one, i) => element(i ? "td" : "th", i ? { class: "text" } : { scope: "row" }, one);
  const tables = whole.tables.map(([name, headers, rows]) => section(name.startsWith("run ") ? "Properties" : inWords(name), headers,
    rows.map(([first, ...others]) => [name.startsWith("run ") ? inWords(first) : first, ...others].map(text))));
  const metrics = whole.metrics.map(([label, value, unit, ...others]) => [
    element("th", { scope: "row" }, withUnit(label, unit)),
    element("td", {}, value === null ? "–" : numberText(value)),
    others.map((one) => text(one, 1))]);
  return [title, element("p", {}, overlay), tables[0],
    section("Metrics", ["Metric", "Value", "Degree of freedom", "Stage", "Model"], metrics),
    tables.slice(1), command];
}

function section(name, headers, rows) {
  return element("section", {}, element("h3", {}, name), scrolling(name,
    element("thead", {}, element("tr", {}, headers.map((header) =>
      element("th", { scope: "col", class: header === "Value" ? null : "label" }, inWords(header))))),
    element("tbody", {}, rows.map((cells) => element("tr", {}, cells)))));
}

function absent(page, id) {
  return `Run ${id} is not among the runs that were written with their series ` +
    `(the newest ${page.runs.summary.opened}): seatrial-results site --runs ${page.runs.all.length} writes all of them.`;
}
