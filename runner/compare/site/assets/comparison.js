"use strict";
// The comparison table: runner/compare/selection.py, pivot.py and comparison_table.py for one
// metric, or coefficient, of one stage, model and degree of freedom.
const COMPARED = ["identifier", "controller", "update"];
const HORIZONS = ["one_step", "ten_step", "restarts", "free_run"];

// { rows, columns, cells: Map, factors, split }, or { refused } if too much would be averaged.
function compare(runs, likeness, chosen, metric, request) {
  const of = new Set(chosen);
  const numbers = metric.filter((number) => of.has(number.run) && number.run.status === "finished");
  const own = request.columns === "none" ? [] : [request.columns];
  const named = [request.rows, ...own];
  const keyOf = (run, names) => names.map((name) => runs.code(run, name)).join(",");
  const cells = Map.groupBy(numbers, (number) => keyOf(number.run, named));
  const split = likeness.differing(cells.values());
  if (split.length > MOST_SPLITS) return { refused: split };
  const rows = [request.rows, ...split];
  const table = { factors: [...rows, ...own], rowFactors: rows, columnFactors: own, split, cells: new Map() };
  const members = Map.groupBy(chosen, (run) => keyOf(run, table.factors));
  const observed = Map.groupBy(numbers, (number) => keyOf(number.run, table.factors));
  const flags = flagsOf(runs.summary, request);
  for (const [key, part] of members) {
    const codes = key.split(",").map(Number);
    const cell = cellOf(observed.get(key) ?? [], part, likeness, flags, runs.summary.t);
    cell.row = codes.slice(0, rows.length);
    cell.column = codes.slice(rows.length);
    table.cells.set(key, cell);
  }
  table.rowKeys = keysOf(table.cells, "row");
  table.columnKeys = keysOf(table.cells, "column");
  if (request.baseline) againstBaseline(table, numbers, request, likeness);
  markBest(table, request, likeness);
  return table;
}

function keysOf(cells, side) {
  const keys = new Map([...cells.values()].map((cell) => [cell[side].join(","), cell[side]]));
  return [...keys.values()].sort((a, b) => {
    const at = a.findIndex((code, i) => code !== b[i]);
    return at < 0 ? 0 : a[at] - b[at];
  });
}

// The runs whose number is marked or left out, for the stage, model and axis of a request.
function flagsOf(summary, request) {
  const { flags } = summary;
  const places = (list, accept) => new Set(list.filter(accept).map((flag) => flag[0]));
  const horizon = HORIZONS.find((name) => request.metric.endsWith(`_${name}`)) ?? "";
  const isForce = request.stage === "validation" && request.model === "identified" &&
    request.metric.startsWith("force_");
  const deployed = request.stage === "deployment";
  const lost = flags.diverged.filter((flag) => flag[1] === request.model && flag[2] === horizon);
  return {
    below: places(flags.below, (flag) => isForce && flag[1] === request.dof),
    unsettled: places(flags.unsettled, (flag) => deployed && flag[1] === request.model),
    infeasible: places(flags.infeasible, (flag) => deployed && flag[1] === request.model),
    diverged: new Map(lost.map((flag) => [flag[0], flag[3]])),
    covering: new Set(flags.covering),
  };
}

function cellOf(observed, members, likeness, flags, table) {
  const finite = observed.filter((number) => Number.isFinite(number.value));
  const withNumber = new Set(finite.map((number) => number.run));
  const lost = observed.filter((n) => !withNumber.has(n.run) && flags.diverged.has(n.run.place));
  lost.forEach((number) => withNumber.add(number.run));
  const distinct = likeness.distinct(finite);
  const values = distinct.map((number) => number.value);
  const has = (places) => distinct.some((number) => places.has(number.run.place));
  const unfinished = members.filter((run) => run.status !== "finished");
  const counts = [...Map.groupBy(unfinished, (run) => run.status)];
  const diverged = likeness.distinct(lost);
  return {
    observed: distinct,
    values,
    mean: statistics.mean(values),
    std: statistics.std(values),
    interval: statistics.interval(values, table),
    unfinished: counts.map(([status, part]) => [status, part.length]).sort(),
    diverged: diverged.length,
    held: median(diverged.map((n) => flags.diverged.get(n.run.place)).filter((v) => v !== null)),
    without: members.filter((run) => run.status === "finished" && !withNumber.has(run)).length,
    ...uncertaintyOf(distinct, flags),
    deterministic: finite.length > 0 && finite.every((n) => likeness.seed(n) === null),
    below: has(flags.below),
    unsettled: has(flags.unsettled),
    infeasible: has(flags.infeasible),
    best: false,
    test: null,
  };
}

// Of coefficients: the root mean square of the standard errors, whether one is of the estimate and
// not of the coefficient, and the true value that all numbers share.
function uncertaintyOf(numbers, flags) {
  const known = numbers.filter((number) => (number.error ?? null) !== null);
  const truths = new Set(numbers.map((number) => number.truth ?? null));
  return {
    error: Math.sqrt(statistics.mean(known.map((number) => number.error ** 2))),
    ofEstimate: known.some((number) => !flags.covering.has(number.run.place)),
    truth: truths.size === 1 ? [...truths][0] ?? NaN : NaN,
  };
}

function median(values) {
  if (!values.length) return NaN;
  const sorted = [...values].sort((a, b) => a - b), middle = Math.floor(sorted.length / 2);
  return sorted.length % 2 ? sorted[middle] : (sorted[middle - 1] + sorted[middle]) / 2;
}

function againstBaseline(table, numbers, request, likeness) {
  const counterparts = new Counterparts(numbers, request.baseline, likeness, table.factors);
  for (const cell of table.cells.values()) {
    const own = cell.observed.filter((number) => !counterparts.isReference(number));
    if (own.length) cell.test = statistics.pairedTest(counterparts.pairs(own), request.better);
    else if (cell.observed.length) cell.isBaseline = true;
  }
}

// Mark the best of the cells that differ only in what is compared; a coefficient is compared by its
// distance from the true value.
function markBest(table, request, likeness) {
  const lossOf = (cell) => (request.term ? Math.abs(cell.mean - cell.truth)
    : request.better === null ? NaN : statistics.loss(cell.mean, request.better));
  const groups = Map.groupBy(table.cells.values(), (cell) => {
    const codes = [...cell.row, ...cell.column];
    const own = table.factors.map((name, i) => (within(name, COMPARED) ? "" : codes[i]));
    const facts = cell.observed.length ? [...likeness.facts(cell.observed[0])] : [];
    const shared = facts.filter(([name]) => !within(name, COMPARED)).map(String).sort();
    return [own.join(","), ...shared].join("\n");
  });
  for (const members of groups.values()) {
    const failed = (cell) => cell.diverged || cell.unfinished.some(([name]) => name !== "running");
    const candidates = members.filter((cell) =>
      Number.isFinite(lossOf(cell)) && !cell.below && !failed(cell));
    if (members.length < 2 || !candidates.length) continue;
    const lowest = Math.min(...candidates.map(lossOf));
    for (const cell of candidates) {
      cell.best = Math.abs(lossOf(cell) - lowest) <= SAME * Math.abs(lowest);
    }
  }
}
