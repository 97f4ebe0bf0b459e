"use strict";
// The data of the page. Scripts in the folder `data` hand over their content by `receive`: a page
// that is opened from disk may load scripts, but not fetch files.
const seatrial = {
  received: new Map(),
  waiting: new Map(),

  receive(name, content) {
    seatrial.received.set(name, content);
  },

  // Load a script once. Resolves to its content.
  load(name) {
    if (!seatrial.waiting.has(name)) {
      seatrial.waiting.set(name, new Promise((resolve, reject) => {
        const script = document.createElement("script");
        script.src = name;
        script.onload = () => {
          script.remove();
          resolve(seatrial.received.get(name));
        };
        script.onerror = () => {
          script.remove();
          seatrial.waiting.delete(name);
          reject(new Error(`${name} cannot be loaded`));
        };
        document.head.append(script);
      }));
    }
    return seatrial.waiting.get(name);
  },
};

// The runs of a summary: objects with their levels by factor.
class Runs {
  constructor(summary) {
    const columns = summary.runs ?? { ids: [], factors: [], experiments: [], statuses: [] };
    const status = statusFactor(columns.statuses);
    this.summary = summary;
    this.factors = new Map([...columns.factors, status].map((factor) => [factor.name, factor]));
    this.all = columns.ids.map((id, place) => ({
      id,
      place,
      status: columns.statuses[place],
      experiment: columns.experiments[place],
      started: columns.started[place],
      duration: columns.duration[place],
    }));
    this.byId = new Map(this.all.map((run) => [run.id, run]));
  }

  // The place of the level of a run among the levels of a factor.
  code(run, name) {
    const factor = this.factors.get(name);
    return factor.codes ? factor.codes[run.place] : factor.by_experiment[run.experiment];
  }

  level(run, name) {
    return this.factors.get(name).levels[this.code(run, name)];
  }

  // Names of the factors with at least two levels that a command may name.
  offered() {
    return [...this.factors.values()]
      .filter((factor) => factor.offered && factor.levels.length > 1)
      .map((factor) => factor.name);
  }

  // The runs of a sweep or tag that meet every filter: a map of factors to sets of levels.
  selected({ sweep, tag, filters }) {
    let chosen = this.all;
    if (sweep !== "all" || tag) {
      const sweeps = this.summary.sweeps.filter((one) =>
        (sweep === "all" || String(one.id) === sweep) && (!tag || one.tags.includes(tag)));
      const places = new Set(sweeps.flatMap((one) => one.runs));
      chosen = chosen.filter((run) => places.has(run.place));
    }
    for (const [name, levels] of filters) {
      const factor = this.factors.get(name);
      if (!factor) continue;
      const codes = new Set([...levels].map((level) => factor.levels.indexOf(level)));
      chosen = chosen.filter((run) => codes.has(this.code(run, name)));
    }
    return chosen;
  }
}

function statusFactor(statuses) {
  const levels = [...new Set(statuses)].sort();
  return {
    name: "status",
    levels,
    kinds: levels.map(() => ["text"]),
    codes: statuses.map((status) => levels.indexOf(status)),
    offered: true,
  };
}
