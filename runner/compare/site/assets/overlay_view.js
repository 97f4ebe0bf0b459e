"use strict";
// Several runs over each other: tracks, errors, residuals, coefficients and Pareto sets.
const MOST_OVERLAID = 8;
const NORMAL_95 = 1.959963984540054;
const ERRORS = [["e_pos", "Position error", "m", 1], ["e_psi", "Heading error", "deg", 180 / Math.PI]];

async function overlayView(page, state) {
  const ids = chosenRuns(state).filter((id) => page.runs.byId.has(id));
  if (!ids.length) {
    return [element("p", {}, "No run is chosen: tick some in the list of ",
      linkTo(state, { view: "runs" }, "runs"), ".")];
  }
  const shown = ids.slice(0, MOST_OVERLAID);
  const loaded = await Promise.all(shown.map((id) => seatrial.load(`data/run-${id}.js`).catch(() => null)));
  const known = loaded.flatMap((run, place) => (run ? [{ ...run, place, label: labelOf(page, shown[place], shown) }] : []));
  const missing = shown.filter((id, i) => !loaded[i]);
  const models = modelsOf(known);
  const model = models.includes(state.deployed) ? state.deployed : models[0];
  return [
    element("div", { class: "row" },
      models.length > 1 ? choice("deployed", "Model", models.map((one) => [one, one]),
        model, (deployed) => page.go({ deployed })) : null,
      element("button", { type: "button", id: "none", click: () => page.go({ runs: "", view: "runs" }) }, "Clear the selection")),
    ids.length > shown.length ? element("p", {}, `Only the first ${MOST_OVERLAID} of ${ids.length} runs are shown.`) : null,
    missing.map((id) => element("p", { class: "refused" }, absent(page, id))),
    known.flatMap((run) => run.trouble).map((text) => element("p", { class: "refused" }, text)),
    element("div", { class: "figures" }, trackFigure(known, model), errorFigures(known, model),
      residualFigures(known, model), paretoFigures(known)),
    coefficientParts(known),
    commandBox(overlayCommands(page, state, known)),
  ];
}

// The models that a run was sailed with or has residuals of.
function modelsOf(known) {
  const sailed = known.flatMap((run) => Object.keys(run.series))
    .filter((kind) => kind.startsWith("deployment_")).map((kind) => kind.slice("deployment_".length));
  const left = known.flatMap((run) => Object.keys(run.series.residual?.lines ?? {}))
    .map((name) => name.split("_")[1]);
  return [...new Set([...sailed, ...left])].sort();
}

// A run by what tells it from the others.
function labelOf(page, id, ids) {
  const { runs } = page;
  const names = [...runs.summary.runs.groups, "seed"].filter((name) =>
    new Set(ids.map((one) => runs.level(runs.byId.get(one), name))).size > 1);
  const levels = names.map((name) => (name === "seed" ? "seed " : "") + runs.level(runs.byId.get(id), name));
  return [`${id}`, ...levels].join(", ");
}

function trackFigure(known, model) {
  const lines = [];
  for (const run of known) {
    const kind = run.series[`deployment_${model}`] ?? run.series.recording;
    const track = kind?.track;
    if (!track?.x || !track.y) continue;
    if (track.x_d && !lines.some((line) => line.label === "reference")) {
      lines.push({ kind: "line", place: 6, dash: true, label: "reference", xs: track.y_d, ys: track.x_d, size: 1.2 });
    }
    lines.push({ kind: "line", place: run.place, label: run.label, xs: track.y, ys: track.x });
    lines.push({ kind: "points", place: run.place, xs: [track.y[0]], ys: [track.x[0]], size: 5 });
  }
  if (!lines.length) return null;
  return drawFigure({ title: "Track (the mark is the start)", series: lines, equal: true,
    x: { label: "East [m]" }, y: { label: "North [m]" } });
}

function errorFigures(known, model) {
  return ERRORS.map(([name, label, unit, factor]) => {
    const lines = known.flatMap((run) => {
      const line = run.series[`deployment_${model}`]?.lines[name];
      return line ? [{ kind: "line", place: run.place, label: run.label, size: 1.1, xs: line[0],
        ys: line[1].map((value) => value * factor) }] : [];
    });
    return lines.length ? drawFigure({ title: `${label} over time, sailed with the ${model} model`, series: lines,
      x: { label: "Time [s]" }, y: { label: `${label} [${unit}]` }, height: 260 }) : null;
  });
}

function residualFigures(known, model) {
  const names = [...new Set(known.flatMap((run) => Object.keys(run.series.residual?.lines ?? {})))]
    .filter((name) => name.startsWith(`residual_${model}_`));
  return names.map((name) => {
    const dof = name.slice(`residual_${model}_`.length);
    const lines = known.flatMap((run) => {
      const line = run.series.residual?.lines[name];
      return line ? [{ kind: "line", place: run.place, label: run.label, size: 1, alpha: 0.85, xs: line[0], ys: line[1] }] : [];
    });
    const unit = known.map((run) => run.series.residual?.units[name]).find(Boolean);
    return drawFigure({ title: `Force residual of the ${model} model, ${dof}`, series: lines,
      x: { label: "Time [s]" }, y: { label: withUnit(inWords(dof), unit) }, height: 240 });
  });
}

// Pairs of objectives: of one degree of freedom where there are more than three.
function paretoFigures(known) {
  const fronts = known.map((run) => ({ ...run, objectives: Map.groupBy(
    run.pareto.filter((row) => row[0] === "pareto_objective"), (row) => row[3]) }))
    .filter((run) => run.objectives.size > 1);
  if (!fronts.length) return [];
  const names = [...fronts[0].objectives].map(([j, rows]) => ({ j, dof: rows[0][1], label: withUnit(rows[0][4] ?? `objective ${j}`, rows[0][6]) }));
  let pairs = names.flatMap((a, i) => names.slice(i + 1).map((b) => [a, b]));
  if (names.length > 3) pairs = pairs.filter(([a, b]) => a.dof === b.dof);
  return pairs.slice(0, 6).map(([a, b]) => drawFigure({
    title: "Pareto set (ring: the chosen point)", x: { label: a.label }, y: { label: b.label },
    series: fronts.flatMap((run) => {
      const value = (j) => new Map((run.objectives.get(j) ?? []).map((row) => [row[2], row[5]]));
      const [xs, ys] = [value(a.j), value(b.j)];
      const places = [...xs.keys()].filter((i) => ys.has(i));
      const chosen = run.pareto.filter((row) => row[0] === "pareto_chosen").map((row) => row[2]);
      const points = (of) => ({ kind: "points", place: run.place, xs: of.map((i) => xs.get(i)), ys: of.map((i) => ys.get(i)) });
      return [{ ...points(places), label: run.label, size: 3 },
        { ...points(chosen.filter((i) => ys.has(i))), size: 8, hollow: true }];
    }),
  }));
}

// The coefficients of the identified models: a figure relative to the true values, and a table.
function coefficientParts(known) {
  const of = known.map((run) => new Map(run.coefficients.rows.filter((row) => row[0] === "identified")
    .map((row) => [`${row[1]}: ${row[2]}`, row])));
  const terms = [...new Set(of.flatMap((rows) => [...rows.keys()]))];
  if (!terms.length) return null;
  const first = (term) => of.map((rows) => rows.get(term)).find(Boolean);
  const body = terms.map((term) => element("tr", {}, element("th", { scope: "row" }, withUnit(term, first(term)[6])),
    of.map((rows) => {
      const row = rows.get(term);
      if (!row) return element("td", {}, "–");
      return element("td", {}, numberText(row[3]),
        row[4] === null ? null : element("span", { class: "under" }, `se ${numberText(row[4], 2)}`));
    }),
    element("td", {}, first(term)[5] === null ? "" : numberText(first(term)[5]))));
  return element("section", {}, element("h2", {}, "Coefficients of the identified models"),
    coefficientFigure(known, of, terms),
    scrolling("Coefficients", element("thead", {}, element("tr", {},
      element("th", { scope: "col", class: "label" }, "Term"),
      known.map((run) => element("th", { scope: "col" }, `Run ${run.label}`)),
      element("th", { scope: "col" }, "True value"))), element("tbody", {}, body)));
}

function coefficientFigure(known, of, terms) {
  const truths = terms.filter((term) => of.some((rows) => rows.get(term)?.[5]));
  if (!truths.length) return null;
  const marks = known.map((run, k) => {
    const one = { kind: "interval", place: run.place, label: run.label, xs: [], ys: [], lows: [], highs: [],
      dash: !run.coefficients.covers, hollow: !run.coefficients.covers };
    truths.forEach((term, i) => {
      const row = of[k].get(term);
      if (!row || row[3] === null || !row[5]) return;
      const half = (NORMAL_95 * (row[4] ?? 0)) / Math.abs(row[5]), value = row[3] / row[5];
      one.xs.push(value);
      one.ys.push(-(i + (0.7 * (k + 0.5)) / known.length - 0.35));
      one.lows.push(value - half);
      one.highs.push(value + half);
    });
    return one;
  });
  const truth = { kind: "line", place: 6, xs: [1, 1], ys: [-truths.length + 0.5, 0.5], size: 1 };
  const shown = marks.flatMap((one) => one.xs).filter((value) => Math.abs(value - 1) <= 4);
  const reach = Math.max(0.05, ...shown.map((value) => Math.abs(value - 1))) * 1.15;
  return drawFigure({
    title: "Identified over true value, with 95 % intervals (hollow and dashed: of the estimate, without its bias)",
    words: "The table below holds the numbers.", series: [truth, ...marks.filter((one) => one.xs.length)],
    x: { label: "Identified / true value", range: [1 - reach, 1 + reach] },
    y: { label: "", size: 110, range: [-truths.length + 0.5, 0.5], splits: truths.map((_, i) => -i).reverse(),
      values: (at) => visible(truths[-at] ?? "") },
    height: 90 + truths.length * Math.max(20, 11 * known.length),
  });
}

function overlayCommands(page, state, known) {
  const line = (kind, id) => commandOf(page.runs, state, ["plot", kind, "--run", String(id)], false);
  return known.flatMap((run) => {
    const kinds = Object.keys(run.series);
    const sailed = kinds.some((kind) => kind.startsWith("deployment_"));
    const planar = kinds.some((kind) => run.series[kind].track.x && run.series[kind].track.y);
    return [
      ...(planar ? [line("track", run.run)] : []),
      ...(sailed && planar ? [line("errors", run.run)] : []),
      ...(kinds.includes("residual") ? [line("residual", run.run)] : []),
      ...(run.coefficients.rows.length ? [line("coefficients", run.run)] : []),
      ...(run.pareto.length ? [line("pareto", run.run)] : []),
    ];
  });
}
