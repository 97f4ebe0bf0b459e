"use strict";
// Shows the view that the address names.
const SHOW = { table: tableView, runs: runsView, overlay: overlayView, failures: failuresView, run: runView };

const page = {
  runs: null,
  shownFilters: new Set(),
  filtersOpen: false,
  turn: 0,

  // Take in the summary of the logbook.
  take(summary) {
    page.runs = new Runs(summary);
    for (const name of page.runs.offered()) {
      if (summary.runs.groups.includes(name)) page.shownFilters.add(name);
    }
    document.getElementById("about").textContent = visible(`${plural(page.runs.all.length, "run")} of ${summary.database}`);
  },

  state() {
    const state = stateOf(location.hash);
    const { sweeps } = page.runs.summary;
    if (!state.sweep) state.sweep = sweeps.length && !state.tag ? String(sweeps.at(-1).id) : "all";
    return state;
  },

  // Change the address, which shows the view.
  go(changes) {
    location.hash = hashOf({ ...page.state(), ...changes });
  },

  async render() {
    const turn = (page.turn += 1), state = page.state(), focused = document.activeElement?.id;
    update(document.getElementById("views"), viewLinks(state));
    const begun = performance.now();
    let parts;
    try {
      if (!page.runs.all.length) parts = [element("p", {}, "No runs in the logbook yet.")];
      else parts = await SHOW[state.view](page, state);
    } catch (error) {
      parts = [element("p", { class: "refused", role: "alert" }, error.message)];
      console.error(error);
    }
    if (turn !== page.turn) return; // a newer one is under way
    const controls = page.runs.all.length && state.view !== "run" && state.view !== "overlay"
      ? controlsOf(page, state) : [];
    const main = document.getElementById("main");
    update(document.getElementById("controls"), controls);
    update(main, parts.flat(Infinity).filter(Boolean));
    if (focused && document.activeElement?.id !== focused) {
      document.getElementById(focused)?.focus({ preventScroll: true });
    }
    main.dataset.shown = location.hash;
    main.dataset.took = String(performance.now() - begun);
  },
};

// Put elements in place of those of before, but leave alone what is the same, what the user has
// opened, and how far a table is scrolled: a sweep changes the page while it is read.
function update(host, elements) {
  const before = [...host.children];
  const opened = before.filter((one) => one.open && one.id).map((one) => one.id);
  const scrolled = new Map([...host.querySelectorAll(".scroll")].map((box) =>
    [box.getAttribute("aria-label"), box.scrollLeft]));
  elements.forEach((fresh, i) => {
    if (opened.includes(fresh.id)) fresh.open = true;
    if (i >= before.length) host.append(fresh);
    else if (!before[i].isEqualNode(fresh)) before[i].replaceWith(fresh);
  });
  before.slice(elements.length).forEach((spare) => spare.remove());
  for (const box of host.querySelectorAll(".scroll")) {
    box.scrollLeft = scrolled.get(box.getAttribute("aria-label")) ?? 0;
  }
}

function viewLinks(state) {
  const chosen = chosenRuns(state).length;
  return Object.entries(VIEWS).filter(([view]) => view !== "run" || state.view === "run").map(([view, label]) =>
    element("a", { href: hashOf({ ...state, view, sort: "", page: "0" }), "aria-current": state.view === view ? "page" : null },
      view === "overlay" && chosen ? `${label} (${chosen})` : label));
}

// The newest sweep and every running one, a line each.
function showProgress({ sweeps }) {
  update(document.getElementById("progress"), sweeps.map((sweep) => {
    const text = `Sweep ${sweep.id} (${sweep.name}): ${sweep.ended} of ${sweep.planned} done, ` +
      `${sweep.running} running, ${sweep.lost} failed`;
    return element("label", {}, element("span", {}, text),
      element("progress", { max: String(sweep.planned || 1), value: String(sweep.ended) }));
  }));
}

function whenResized(act) {
  let wide = innerWidth, timer = 0;
  addEventListener("resize", () => {
    if (innerWidth === wide) return; // the bar of a phone's browser comes and goes
    wide = innerWidth;
    clearTimeout(timer);
    timer = setTimeout(act, 200);
  });
}

async function start() {
  const summary = await seatrial.load("data/summary.js");
  page.take(summary);
  showProgress(await seatrial.load("data/progress.js"));
  await page.render();
  addEventListener("hashchange", page.render);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", page.render);
  whenResized(page.render);
  document.getElementById("skip").addEventListener("click", (event) => {
    event.preventDefault(); // the address holds the view
    document.getElementById("main").focus();
  });
}
start().catch((error) => {
  document.getElementById("main").textContent = `The results cannot be shown: ${error.message}`;
});
