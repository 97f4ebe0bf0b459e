"use strict";
// Any metric or coefficient by any two factors: means over seeds with 95 % intervals, and a figure with every seed.
const PREFERRED = [["e_pos_mae", "deployment"], ["velocity_rmse_free_run", "validation"], ["force_mse", "validation"]];
const MARKS = {
  below: ["†", "the force error is below that of the true plant: the model fits lag or feedback, not the vessel"],
  unsettled: ["‡", "the controller's closed loop has a spectral radius of 1 or more on its own model"],
  infeasible: ["§", "the weather needs more force than the limits allow"],
};
const LOGARITHMIC_FROM = 100; // largest over smallest value
const TRUTH = 6; // the colour of a reference

// The metric, stage, degree of freedom and model of a state; what it leaves open is chosen here.
function measureOf(summary, state) {
  const { measures, orders } = summary;
  if (!measures.length) return null;
  const preferred = PREFERRED.map((one) => measures.find((m) => m.name === one[0])).find(Boolean);
  const measure = measures.find((one) => one.name === state.metric) ?? preferred ?? measures[0];
  const rank = (order, level) => (order.includes(level) ? order.indexOf(level) : order.length);
  const pick = (at, order, wanted, parts) => {
    const levels = [...new Set(parts.map((part) => part[at]))]
      .sort((a, b) => rank(order, a) - rank(order, b) || (a < b ? -1 : 1));
    const first = at === 1 && levels.includes("identified") ? "identified" : levels[0];
    return [levels, levels.includes(wanted) ? wanted : first];
  };
  const [stages, stage] = pick(0, [], state.stage, measure.parts);
  const ofStage = measure.parts.filter((part) => part[0] === stage);
  const [models, model] = pick(1, orders.model, state.model, ofStage);
  const ofModel = ofStage.filter((part) => part[1] === model);
  const [dofs, dof] = pick(2, orders.dof, state.dof, ofModel);
  const unit = ofModel.find((part) => part[2] === dof)[3];
  return { measure, stage, model, dof, unit, levels: { stage: stages, model: models, dof: dofs } };
}

// The numbers of a metric for one stage, model and degree of freedom.
async function numbersOf(page, chosen) {
  const parts = await seatrial.load(chosen.measure.script);
  const part = parts.find((one) =>
    one.stage === chosen.stage && one.model === chosen.model && one.dof === chosen.dof);
  const { stage, model, dof } = chosen, { name } = chosen.measure;
  return (part?.runs ?? []).flatMap((id, i) => {
    const run = page.runs.byId.get(id);
    const number = { run, value: part?.values[i] ?? NaN, stage, model, dof, name };
    return run ? [{ ...number, error: part.errors?.[i], truth: part.truths?.[i] }] : [];
  });
}

// What a state asks for, the runs that it selects, and the table of them; null without a metric.
async function comparisonOf(page, state) {
  const chosen = measureOf(page.runs.summary, state);
  if (!chosen) return null;
  const has = (name) => page.runs.factors.has(name);
  const rows = has(state.rows) ? state.rows : "identifier";
  const columns = has(state.columns) && state.columns !== rows ? state.columns : "none";
  const [factor, level] = splitOnce(state.baseline);
  const isKnown = page.runs.factors.get(factor)?.levels.includes(level);
  const request = {
    rows, columns, metric: chosen.measure.name, term: chosen.measure.term, stage: chosen.stage, model: chosen.model,
    dof: chosen.dof, better: chosen.measure.better, baseline: isKnown ? [factor, level] : null,
  };
  const selected = page.runs.selected(state);
  const numbers = await numbersOf(page, chosen);
  return { chosen, request, selected, table: compare(page.runs, page.likeness, selected, numbers, request) };
}

async function tableView(page, state) {
  const asked = await comparisonOf(page, state);
  if (!asked) return [element("p", {}, "No run has a metric yet.")];
  const { chosen, request, selected, table } = asked;
  const parts = [pickers(page, state, chosen, request)];
  if (!selected.length) return [...parts, element("p", {}, "No run meets the filters.")];
  const command = commandBox(commandsOf(page, state, request, chosen));
  if (table.refused) return [...parts, refusal(table.refused), command];
  return [...parts, heading(chosen, selected), gridOf(page, state, table, chosen, request),
    notesOf(table, chosen, request), figureOf(page, table, chosen, request), command];
}

function splitOnce(text) {
  const at = text.indexOf("=");
  return at < 0 ? ["", ""] : [text.slice(0, at), text.slice(at + 1)];
}

function pickers(page, state, chosen, request) {
  const { runs } = page;
  const factors = runs.offered();
  for (const one of [request.columns, request.rows]) {
    if (one !== "none" && !factors.includes(one)) factors.unshift(one);
  }
  const named = factors.map((name) => [name, inWords(name)]);
  const metrics = runs.summary.measures.map((one) =>
    [one.name, one.label, one.term ? "Coefficients" : "Metrics"]);
  const part = (name) => (chosen.levels[name].length > 1 ? choice(name, PARTS[name],
    chosen.levels[name].map((level) => [level, level]), chosen[name], (value) => page.go({ [name]: value })) : null);
  const baselines = [request.rows, request.columns].filter((name) => name !== "none").flatMap((name) =>
    runs.factors.get(name).levels.slice(0, 50).map((level) => [`${name}=${level}`, `${inWords(name)}: ${level}`]));
  return element("div", { class: "row" },
    choice("metric", "Metric or coefficient", metrics, chosen.measure.name, (metric) => page.go({ metric })),
    part("stage"), part("dof"), part("model"),
    choice("rows", "Rows", named, request.rows, (rows) => page.go({ rows, sort: "" })),
    choice("columns", "Columns", [["none", "None"], ...named.filter(([name]) => name !== request.rows)],
      request.columns, (columns) => page.go({ columns, sort: "" })),
    choice("baseline", "Baseline", [["", "None"], ...baselines], state.baseline,
      (baseline) => page.go({ baseline })));
}
const PARTS = { stage: "Stage", dof: "Degree of freedom", model: "Model" };

function refusal(factors) {
  const names = factors.slice(0, 8).join(", ") + (factors.length > 8 ? ", …" : "");
  return element("p", { class: "refused" },
    `The cells of this table would average over ${names}: choose them as rows or columns, or filter.`);
}

function heading(chosen, selected) {
  const about = `${withUnit(chosen.measure.label, chosen.unit)}, ${chosen.dof}, ${chosen.stage}, ${chosen.model}`;
  return element("div", {},
    element("h2", {}, about),
    element("p", { class: "small" },
      `Mean ± standard deviation [95 % interval] over seeds, ${plural(selected.length, "run")}. ` +
      `${inWords(chosen.measure.formula)}.`));
}

function gridOf(page, state, table, chosen, request) {
  const labelOf = (names, key) => key.map((code, i) => page.runs.factors.get(names[i]).levels[code]);
  const cellAt = (row, column) => table.cells.get([...row, ...column].join(","));
  const columnName = (key) => labelOf(table.columnFactors, key).join(", ") || "Value";
  const sort = state.sort.replace(/^-/, "");
  const at = table.columnKeys.findIndex((key) => `column-${key.join("-")}` === sort);
  let rows = table.rowKeys;
  if (at >= 0) rows = sorted(rows, (row) => cellAt(row, table.columnKeys[at])?.mean, state.sort.startsWith("-"));
  return scrolling(`${chosen.measure.label} by ${request.rows} and ${request.columns}`,
    element("thead", {}, element("tr", {},
      element("th", { scope: "col", class: "label" }, table.rowFactors.map(inWords).join(", ")),
      table.columnKeys.map((key) =>
        sortHeading(page, state, `column-${key.join("-")}`, columnName(key))))),
    element("tbody", {}, rows.map((row) => element("tr", {},
      element("th", { scope: "row" }, labelOf(table.rowFactors, row).join(", ")),
      table.columnKeys.map((column) => cellElement(cellAt(row, column), chosen.measure,
        hashOf({ ...state, view: "runs", sort: "", page: "0",
          filters: narrowed(state.filters, [...table.rowFactors, ...table.columnFactors],
            [...labelOf(table.rowFactors, row), ...labelOf(table.columnFactors, column)]) })))))));
}

// The filters that select the runs of one cell.
function narrowed(filters, names, levels) {
  return new Map([...filters, ...names.map((name, i) => [name, new Set([levels[i]])])]);
}

// The texts of a cell: value, spread, counts, and the test against the baseline.
function cellTexts(cell, measure) {
  const marks = Object.keys(MARKS).filter((name) => cell[name]).map((name) => ` ${MARKS[name][0]}`);
  const value = (cell.observed.length ? numberText(cell.mean) : "–") + marks.join("");
  const zero = cell.std < SAME * Math.abs(cell.mean);
  const spread = Number.isFinite(cell.std) ? `± ${zero ? "0" : numberText(cell.std, 2)}` : "";
  const [low, high] = cell.interval;
  const interval = Number.isFinite(low) ? `[${numberText(low)}, ${numberText(high)}]` : "";
  const once = cell.deterministic && cell.observed.length === 1;
  const held = Number.isNaN(cell.held) ? "" : `, held ${numberText(cell.held, 2)} s`;
  const counts = [
    cell.observed.length ? (once ? "deterministic" : `n=${cell.observed.length}`) : null,
    ...cell.unfinished.map(([status, count]) => `${count} ${status}`),
    cell.diverged ? `${cell.diverged} diverged in prediction${held}` : null,
    cell.without ? `${cell.without} without value` : null,
  ].filter(Boolean).join(", ");
  const test = cell.test ? testText(cell.test, measure) : cell.isBaseline ? "baseline" : "";
  const error = Number.isNaN(cell.error) ? ""
    : `se ${numberText(cell.error, 2)}${cell.ofEstimate ? " of the estimate" : ""}`;
  const truth = Number.isNaN(cell.truth) ? "" : `true ${numberText(cell.truth)}`;
  return { value, spread, interval, uncertainty: [error, truth].filter(Boolean).join(", "), counts, test };
}

function testText(test, measure) {
  if (!test.pairs) return "no counterpart";
  const sign = test.difference >= 0 ? "+" : "";
  const ratio = measure.score ? sign + numberText(test.difference, 3)
    : `× ${Number.isNaN(test.ratio) ? "–" : numberText(test.ratio, 3)}`;
  const p = Number.isNaN(test.p) ? plural(test.pairs, "pair") : `p ${Number(test.p.toPrecision(2))}`;
  return `${ratio}, ${p}${test.wins === null ? "" : `, won ${test.wins}/${test.pairs}`}`;
}

// A cell; its counts link to the list of its runs.
function cellElement(cell, measure, runs) {
  if (!cell) return element("td");
  const { value, spread, interval, uncertainty, counts, test } = cellTexts(cell, measure);
  const under = (content) => (content ? element("span", { class: "under" }, content) : null);
  return element("td", { "data-mean": Number.isFinite(cell.mean) ? String(cell.mean) : null },
    element(cell.best ? "strong" : "span", {}, value), under(spread), under(interval),
    under(uncertainty), under(element("a", { href: runs }, counts)), under(test));
}

function notesOf(table, chosen, request) {
  const cells = [...table.cells.values()];
  const notes = Object.keys(MARKS).filter((name) => cells.some((cell) => cell[name]))
    .map((name) => MARKS[name].join(" "));
  if (table.split.length) notes.unshift(`Split by ${table.split.join(", ")}, in which runs of one cell differ.`);
  if (chosen.measure.note) notes.push(chosen.measure.note);
  if (request.baseline) {
    notes.push(`× is the ratio of means to ${request.baseline.join("=")} with all else equal, over pairs of the ` +
      "same seed (of scores the difference); p is that of the two-sided Wilcoxon signed-rank test over at least " +
      "five pairs, not corrected for multiple comparisons; won is the number of pairs in which it is better.");
  }
  if (cells.some((cell) => cell.ofEstimate)) {
    notes.push("se of the estimate: an interval of this identifier is one of its estimate, not of the " +
      "coefficient, because it does not include the bias.");
  }
  const best = request.term ? "nearest to the true value" : "best";
  if (cells.some((cell) => cell.best)) notes.push(`Bold: the ${best} among equal circumstances.`);
  return element("ul", { class: "notes small" }, notes.map((note) => element("li", {}, note)));
}

// One line for every row and column: every seed as a faint mark, mean and interval.
function figureOf(page, table, chosen, request) {
  const names = table.rowFactors, labels = table.rowKeys.map((key) =>
    key.map((code, i) => page.runs.factors.get(names[i]).levels[code]).join(", "));
  const columns = table.columnKeys.map((key) =>
    key.map((code, i) => page.runs.factors.get(table.columnFactors[i]).levels[code]).join(", "));
  const seeds = columns.map((_, place) => ({ kind: "points", place, alpha: 0.45, size: 3, xs: [], ys: [] }));
  const means = columns.map((label, place) => ({ kind: "interval", place, label, xs: [], ys: [], lows: [], highs: [] }));
  const truths = { kind: "points", place: TRUTH, label: "true value", hollow: true, size: 5, xs: [], ys: [] };
  table.rowKeys.forEach((row, i) => table.columnKeys.forEach((column, j) => {
    const cell = table.cells.get([...row, ...column].join(","));
    if (!cell?.observed.length) return;
    const y = -(i + (0.75 * (j + 0.5)) / columns.length - 0.375);
    for (const value of cell.values) {
      seeds[j].xs.push(value);
      seeds[j].ys.push(y);
    }
    means[j].xs.push(cell.mean);
    means[j].ys.push(y);
    means[j].lows.push(cell.interval[0]);
    means[j].highs.push(cell.interval[1]);
    if (Number.isNaN(cell.truth)) return;
    truths.xs.push(cell.truth);
    truths.ys.push(y);
  }));
  const values = [...seeds, truths].flatMap((one) => one.xs);
  if (!values.length) return null;
  const low = values.reduce((a, b) => Math.min(a, b)), high = values.reduce((a, b) => Math.max(a, b));
  const log = low > 0 && high > LOGARITHMIC_FROM * low;
  for (const one of means) if (log) one.floor = low / 1.3;
  if (log) means.forEach((one) => { one.lows = one.lows.map((v) => (v > 0 ? v : low / 1.25)); });
  const short = labels.map((label) => (label.length > 16 ? `${label.slice(0, 15)}…` : label));
  const longest = Math.max(...short.map((label) => label.length));
  return drawFigure({
    title: `${chosen.measure.label} of every seed, with the mean and its 95 % interval`,
    words: `${labels.length} rows, ${columns.length} columns; the table above holds the numbers.`,
    series: [...seeds, ...means, truths].filter((one) => one.xs.length),
    legend: table.columnFactors.length > 0 || truths.xs.length > 0,
    x: { label: withUnit(`${chosen.measure.label}, ${chosen.dof}`, chosen.unit), log },
    y: { label: "", size: 16 + 6.6 * longest, range: [-labels.length + 0.5, 0.5],
      splits: labels.map((_, i) => -i).reverse(), values: (at) => visible(short[-at] ?? "") },
    height: 90 + labels.length * Math.max(26, 15 * columns.length),
  });
}

function commandsOf(page, state, request, chosen) {
  const factors = ["--rows", request.rows, "--columns", request.columns];
  const metric = request.term ? ["--coefficient", request.term] : ["--metric", request.metric];
  const axis = ["--dof", chosen.dof, "--model", chosen.model];
  const baseline = request.baseline ? ["--baseline", request.baseline.join("=")] : [];
  const stage = request.term ? [] : ["--stage", chosen.stage];
  const table = ["table", ...metric, ...stage, ...axis, ...factors, "--statistic", "mean,std,ci,n", ...baseline];
  const lines = [commandOf(page.runs, state, table)];
  if (request.term) lines.push(commandOf(page.runs, state, ["plot", "coefficients"]));
  else if (request.columns !== "none") lines.push(commandOf(page.runs, state, ["plot", "bars", ...metric, ...axis, ...factors]));
  return lines;
}
