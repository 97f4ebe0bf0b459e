// The list of runs: filtered, sorted, ticked; the ticked ones are overlaid. The address is the state.
const PER_PAGE = 100, MOST_OVERLAID = 8;
const data = seatrial.runs;

function stateOf() {
  const words = new URLSearchParams(location.hash.slice(1));
  const text = (name) => words.get(name) ?? "";
  return {
    words, sweep: text("sweep"), sort: text("sort"), model: text("model"), page: Number(text("page")),
    measure: data.measures[Number(text("metric"))] ?? data.measures[0],
    ticked: text("runs").split(",").filter((id) => data.ids.includes(Number(id))),
    filters: data.factors.map((factor) => words.getAll(`where.${factor.name}`)),
  };
}

// Change words of the address, which shows the list anew; a list of values is one word for each.
function go(changes) {
  const { words } = stateOf();
  for (const [name, value] of Object.entries({ page: "", ...changes })) {
    words.delete(name);
    for (const one of [value].flat()) if (one) words.append(name, one);
  }
  location.hash = words.toString();
}

// The places of the runs of the sweep that meet every filter.
function selected({ sweep, filters }) {
  const members = new Set(data.sweeps.find((one) => String(one.id) === sweep)?.runs);
  const codes = filters.map((levels, i) => new Set(levels.map((level) => data.factors[i].levels.indexOf(level))));
  return data.ids.map((_, place) => place).filter((place) => (!sweep || members.has(place)) &&
    codes.every((wanted, i) => !wanted.size || wanted.has(data.factors[i].codes[place])));
}

// The columns of the list: a name, a heading and the texts of all runs.
function columnsOf({ measure }) {
  const varied = data.factors.filter((factor) => factor.shown);
  return [
    { name: "run", label: "Run", texts: data.ids },
    ...(measure ? [{ name: "value", label: measure.label, texts: measure.values }] : []),
    ...varied.map((factor) => ({ name: factor.name, label: factor.name, texts: factor.codes.map((code) => factor.levels[code]) })),
    { name: "duration", label: "duration [s]", texts: data.duration },
    { name: "started", label: "started (UTC)", texts: data.started },
  ];
}

// By number, or else by text; what is missing comes last, either way.
function inOrder(places, columns, sort) {
  const texts = columns.find((column) => column.name === sort.replace(/^-/, ""))?.texts ?? data.ids;
  const down = !sort || sort.startsWith("-") ? -1 : 1;
  const keyed = places.map((place) => [texts[place] ?? "", Number(texts[place] || NaN), place]);
  return keyed.sort(([a, x], [b, y]) => {
    if (a === "" || b === "") return (a === "") - (b === "");
    return down * (Number.isNaN(x) || Number.isNaN(y) ? String(a).localeCompare(String(b), "en", { numeric: true }) : x - y);
  }).map((key) => key[2]);
}

function shellQuoted(word) {
  return /^[\w@%+=:,./-]+$/.test(word) ? word : `'${word.replaceAll("'", `'"'"'`)}'`;
}

// A command line that selects the same runs.
function commandOf(first, { sweep, filters }) {
  const parts = filters.flatMap((levels, i) => {
    const { name } = data.factors[i], quoted = (level) => `"${level.replaceAll('"', '""')}"`;
    const written = (level) => name === "seed" ? level : level === "none" ? 'null,"none"' : quoted(level);
    return levels.length ? [`${name} in (${levels.map(written).join(",")})`] : [];
  });
  const words = [...first, ...(parts.length ? ["--where", parts.join(" and ")] : []), "--sweep", sweep || "all", ...data.database];
  return [data.program, ...words.map(shellQuoted)].join(" ");
}

function filtersOf(state) {
  const sets = data.factors.map((factor, i) => element("fieldset", {}, element("legend", {}, factor.name),
    factor.levels.slice(0, 200).map((level, k) => element("label", {}, element("input", {
      type: "checkbox", id: `filter-${factor.name}-${k}`, checked: state.filters[i].includes(level),
      change: (event) => go({ [`where.${factor.name}`]: event.target.checked
        ? [...state.filters[i], level] : state.filters[i].filter((one) => one !== level) }) }), level))));
  return element("details", { id: "filters", open: document.getElementById("filters")?.open },
    element("summary", {}, "Filters"), sets);
}

function tableOf(state, columns, places) {
  const head = columns.map(({ name, label }) => element("th", { scope: "col", class: name === "run" ? "label" : null,
    "aria-sort": { [name]: "ascending", [`-${name}`]: "descending" }[state.sort] },
  element("button", { type: "button", id: `sort-${name}`, click: () => go({ sort: state.sort === name ? `-${name}` : name }) }, label)));
  const tick = (id) => element("input", { type: "checkbox", id: `tick-${id}`, checked: state.ticked.includes(id),
    "aria-label": `Overlay run ${id}`, change: (event) => go({ page: String(state.page),
      runs: (event.target.checked ? [...state.ticked, id] : state.ticked.filter((one) => one !== id)).join(",") }) });
  const body = places.map((place) => element("tr", {}, columns.map(({ name, texts }) => {
    const text = texts[place] ?? "–", id = String(data.ids[place]);
    if (name === "run") {
      const label = data.written.includes(data.ids[place]) ? element("a", { href: `run-${id}.html` }, id) : id;
      return element("th", { scope: "row" }, element("label", {}, tick(id), label));
    }
    return element("td", {}, name === "status" ? element("span", { class: `status ${text}` }, text) : text);
  })));
  const box = element("div", { class: "scroll", tabindex: "0" }, element("table", {},
    element("thead", {}, element("tr", {}, head)), element("tbody", {}, body)));
  watch(box);
  return box;
}

function listOf(state) {
  const columns = columnsOf(state), places = inOrder(selected(state), columns, state.sort);
  const pages = Math.ceil(places.length / PER_PAGE), page = Math.min(state.page, Math.max(pages - 1, 0));
  const turn = (label, to) => element("button", { type: "button", disabled: to < 0 || to >= pages, click: () => go({ page: String(to) }) }, label);
  const own = { ...state, page };
  const sweeps = data.sweeps.map((sweep) => [String(sweep.id), `${sweep.id}: ${sweep.name}`]).reverse();
  return [
    choice("sweep", "Sweep", [["", "all"], ...sweeps], state.sweep, (sweep) => go({ sweep })),
    data.measures.length ? choice("metric", "Metric", data.measures.map((one, i) => [String(i), one.label]),
      String(data.measures.indexOf(state.measure)), (metric) => go({ metric })) : null,
    filtersOf(state),
    element("p", {}, `${places.length} run${places.length === 1 ? "" : "s"}; tick runs to overlay them.`),
    tableOf(own, columns, places.slice(page * PER_PAGE, (page + 1) * PER_PAGE)),
    pages > 1 ? element("p", {}, turn("Previous", page - 1), ` Page ${page + 1} of ${pages} `, turn("Next", page + 1)) : null,
    element("p", {}, "The commands of this selection:"),
    element("pre", { class: "commands" }, element("code", {}, [commandOf(["runs", "--limit", String(places.length || 1)], state),
      ...(state.measure ? [commandOf(["table", "--metric", state.measure.metric], state)] : [])].join("\n"))),
  ].filter(Boolean);
}

// Load the figures of a run; null if they are not written.
function loaded(id) {
  if (seatrial[`run-${id}`]) return Promise.resolve(seatrial[`run-${id}`]);
  return new Promise((resolve) => {
    const script = element("script", { src: `data/run-${id}.js`, load: () => resolve(seatrial[`run-${id}`]), error: () => resolve(null) });
    document.head.append(script);
  });
}

async function overlayOf({ ticked, model }) {
  const ids = ticked.slice(0, MOST_OVERLAID), runs = await Promise.all(ids.map(loaded));
  const known = runs.filter(Boolean), models = modelsOf(known), missing = ids.filter((id, i) => !runs[i]);
  const chosen = models.includes(model) ? model : models.includes("identified") ? "identified" : models[0];
  return [
    ids.length ? element("h2", {}, `Overlay of run${ids.length === 1 ? "" : "s"} ${ids.join(", ")}`) : null,
    ticked.length > ids.length ? element("p", { class: "refused" }, `Only the first ${MOST_OVERLAID} of ${ticked.length} runs are shown.`) : null,
    missing.length ? element("p", { class: "refused" }, `Not written with their series: ${missing.join(", ")}; ` +
      `seatrial-results site --runs ${data.ids.length} writes all runs.`) : null,
    known.flatMap((run) => run.trouble).map((text) => element("p", { class: "refused" }, text)),
    known.length > 1 && models.length > 1 ? choice("model", "Model", models.map((one) => [one, one]), chosen, (one) => go({ model: one })) : null,
    element("div", { class: "figures" }, figuresOf(known, chosen)),
  ].flat().filter(Boolean);
}

async function show() {
  const state = stateOf(), hash = location.hash, focused = document.activeElement?.id;
  const overlay = await overlayOf(state);
  if (hash !== location.hash) return; // a newer state is under way
  document.getElementById("plots").replaceChildren(...overlay);
  document.getElementById("list").replaceChildren(...listOf(state));
  if (focused) document.getElementById(focused)?.focus({ preventScroll: true });
  document.body.dataset.shown = hash;
}
addEventListener("hashchange", show);
show();
