"use strict";
// The tables of a sweep, which the command line has made, and the command of each.

async function tableView(page, state) {
  const { opening } = page.runs.summary;
  const written = state.sweep === "all" ? !state.tag : opening.includes(Number(state.sweep));
  if (!written || state.filters.size) return otherSelection(page, state);
  const told = await seatrial.load(`data/tables-${state.sweep}.js`);
  return [
    element("ul", { class: "answers" }, told.answers.map((text) => element("li", {}, text))),
    told.tables.map((table, i) => tableSection(page, state, table, i)),
    told.refused.map((text) => element("p", { class: "refused" }, `Not shown: ${text}`)),
    told.tables.length || told.refused.length ? null : element("p", {}, "No run has a metric yet."),
  ];
}

// A selection whose tables are not written: the command that makes them.
function otherSelection(page, state) {
  const name = page.runs.summary.measures.find((one) => one.name === "e_pos_mae")?.name ?? "force_mse";
  return [element("p", {}, "The tables of this selection are made by the command:"),
    commandBox([commandOf(page.runs, state, ["table", "--metric", name])])];
}

function tableSection(page, state, table, place) {
  const sort = state.sort.replace(/^-/, ""), mark = `${place}-`;
  const by = sort.startsWith(mark) ? Number(sort.slice(mark.length)) : -1;
  const key = (row) => row[by][2] ?? (by < table.labels ? row[by][0] : NaN);
  const rows = by < 0 ? table.rows : sorted(table.rows, key, state.sort.startsWith("-"));
  const heads = table.headers.map((header, i) =>
    sortHeading(page, state, `${mark}${i}`, header, i < table.labels ? { class: "label" } : {}));
  return element("details", { id: `table-${place}`, open: table.shown },
    element("summary", {}, table.caption),
    element("p", { class: "small" }, table.title),
    scrolling(table.caption, element("thead", {}, element("tr", {}, heads)),
      element("tbody", {}, rows.map((row) => element("tr", {}, row.map((cell, i) =>
        cellElement(cell, i < table.labels)))))),
    element("ul", { class: "notes small" }, table.notes.map((note) => element("li", {}, note))),
    commandBox([commandOf(page.runs, state, table.command)]));
}

function cellElement([text, bold, value], isLabel) {
  const [first, ...others] = text.split("\n");
  return element(isLabel ? "th" : "td", { scope: isLabel ? "row" : null, "data-value": value },
    element(bold ? "strong" : "span", {}, first), others.map((line) => element("span", { class: "under" }, line)));
}
