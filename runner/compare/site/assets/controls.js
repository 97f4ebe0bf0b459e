"use strict";
// The controls above every view: sweep, tag and filters. A change goes into the address.

// `values` are pairs of a value and its text, and may name a group.
function choice(id, label, values, current, change) {
  const option = ([value, text]) => element("option", { value, selected: value === current }, text);
  const groups = Map.groupBy(values, (one) => one[2] ?? "");
  const options = [...groups].map(([group, members]) =>
    (group ? element("optgroup", { label: group }, members.map(option)) : members.map(option)));
  return element("label", { class: "choice", for: id }, element("span", {}, label),
    element("select", { id, change: (event) => change(event.target.value) }, options));
}

function controlsOf(page, state) {
  const { runs } = page, { sweeps } = runs.summary;
  const tags = [...new Set(sweeps.flatMap((sweep) => sweep.tags))].sort();
  const newest = [...sweeps].reverse().map((sweep) =>
    [String(sweep.id), `${sweep.id}: ${sweep.name} (${plural(sweep.runs.length, "run")})`]);
  return [
    element("div", { class: "row" },
      choice("sweep", "Sweep", [["all", `All runs (${runs.all.length.toLocaleString("en")})`], ...newest],
        state.sweep, (sweep) => page.go({ sweep, page: "0" })),
      tags.length ? choice("tag", "Tag", [["", "Any"], ...tags.map((tag) => [tag, tag])],
        state.tag, (tag) => page.go({ tag, sweep: tag ? "all" : state.sweep, page: "0" })) : null),
    filtersOf(page, state),
  ];
}

function filtersOf(page, state) {
  const { runs } = page;
  const shown = [...new Set([...state.filters.keys(), ...page.shownFilters])]
    .filter((name) => runs.factors.has(name));
  const others = runs.offered().filter((name) => !shown.includes(name));
  const counted = shown.filter((name) => state.filters.has(name)).length;
  const box = element("details", { class: "filters", id: "filters", open: page.filtersOpen },
    element("summary", {}, counted ? `Filters (${counted})` : "Filters"),
    choice("add-filter", "Filter by", [["", "Choose a factor"], ...others.map((n) => [n, inWords(n)])],
      "", (name) => {
        page.shownFilters.add(name);
        page.render();
      }),
    element("div", { class: "fieldsets" }, shown.map((name) => fieldsetOf(page, state, name))),
    counted ? element("button", { type: "button", id: "clear", click: () => {
      page.shownFilters.clear();
      page.go({ filters: new Map(), page: "0" });
    } }, "Clear filters") : null);
  box.addEventListener("toggle", () => { page.filtersOpen = box.open; });
  return box;
}

function fieldsetOf(page, state, name) {
  const factor = page.runs.factors.get(name), levels = state.filters.get(name) ?? new Set();
  return element("fieldset", {}, element("legend", {}, inWords(name)),
    factor.levels.slice(0, 200).map((level, i) => element("label", { class: "level" },
      element("input", { type: "checkbox", id: `filter-${name}-${i}`, checked: levels.has(level),
        change: (event) => {
          const filters = new Map(page.state().filters), kept = new Set(filters.get(name));
          if (event.target.checked) kept.add(level);
          else kept.delete(level);
          if (kept.size) filters.set(name, kept);
          else filters.delete(name);
          page.shownFilters.add(name);
          page.go({ filters, page: "0" });
        } }), level)));
}

// The heading of a column that sorts its table by a click; `sort` is "column" or "-column".
function sortHeading(page, state, name, label, attributes = {}) {
  const down = state.sort === `-${name}`, up = state.sort === name;
  return element("th", { scope: "col", ...attributes,
    "aria-sort": up ? "ascending" : down ? "descending" : null },
  element("button", { type: "button", id: `sort-${name}`,
    click: () => page.go({ sort: up ? `-${name}` : name, page: "0" }) }, label));
}

// Order of two values: numbers by size, then texts; what is missing comes last, either way.
function sorted(items, keyOf, down) {
  const keyed = items.map((item) => [keyOf(item), item]);
  const missing = (key) => key === null || key === undefined || Number.isNaN(key);
  keyed.sort(([a], [b]) => {
    if (missing(a) || missing(b)) return missing(a) - missing(b);
    const numbers = typeof a === "number" && typeof b === "number";
    const order = numbers ? a - b : String(a).localeCompare(String(b), "en", { numeric: true });
    return down ? -order : order;
  });
  return keyed.map((pair) => pair[1]);
}

// A table in a box that scrolls sideways under its sticky first column.
function scrolling(label, ...parts) {
  return element("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": label },
    element("table", {}, element("caption", { class: "hidden" }, label), ...parts));
}
