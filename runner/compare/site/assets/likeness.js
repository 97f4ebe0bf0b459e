"use strict";
// What may be averaged and what is a replicate: the rules of runner/compare/likeness.py.
// A number is { run, value, stage, model, dof, name }.
const MOST_SPLITS = 3;

function within(key, names) {
  return names.some((name) => key === name || key.startsWith(`${name}.`));
}

class Likeness {
  constructor(runs) {
    this.runs = runs;
    this.told = runs.summary.runs?.circumstances;
    this.rules = runs.summary.runs?.rules;
    this.known = new Map(); // by experiment and ignored names
    this.numbers = new Map();
  }

  // The names that tell runs apart, with the codes of their levels, for one number.
  facts(number) {
    return this.numbered(number).facts;
  }

  // Equal for numbers of equal circumstances.
  number(number) {
    return this.numbered(number).place;
  }

  numbered(number) {
    const after = number.stage !== "deployment";
    const without = this.rules.without_identifier.includes(number.model);
    const key = `${number.run.experiment} ${after} ${without}`;
    if (!this.known.has(key)) {
      const ignored = [...(after ? this.rules.after : []), ...(without ? ["identifier"] : [])];
      const facts = new Map();
      for (const name of this.told.shapes[this.told.shape_of[number.run.experiment]]) {
        if (within(this.told.names[name], ignored)) continue;
        const column = this.told.columns[this.told.column_of[name]];
        facts.set(this.told.names[name], column[number.run.experiment]);
      }
      const content = [...facts].map(([name, code]) => `${name}=${code}`).sort().join("\n");
      if (!this.numbers.has(content)) this.numbers.set(content, this.numbers.size);
      this.known.set(key, { place: this.numbers.get(content), facts });
    }
    return this.known.get(key);
  }

  // The seed of a number; null if it does not depend on it.
  seed(number) {
    const { drawn } = number.run;
    if (drawn === null) return this.runs.level(number.run, "seed");
    const without = this.rules.without_identifier.includes(number.model);
    const streams = drawn.filter((stream) => !(without && stream === "identifier"));
    return streams.length ? this.runs.level(number.run, "seed") : null;
  }

  experiment(number) {
    return `${this.number(number)} ${this.seed(number)} ${number.stage} ${number.model} ` +
      `${number.dof} ${number.name}`;
  }

  // One number of every experiment, the newest, in the order of the first.
  distinct(numbers) {
    return [...new Map(numbers.map((number) => [this.experiment(number), number])).values()];
  }

  // The factors that make every cell alike if they become factors of the table.
  differing(cells) {
    let parts = [...cells]
      .map((cell) => [...new Map(cell.map((n) => [this.number(n), this.facts(n)])).values()])
      .filter((part) => part.length > 1);
    const names = new Set(parts.flat().flatMap((facts) => [...facts.keys()]));
    const groups = this.runs.summary.runs.groups;
    const factors = [];
    for (const name of [...groups, ...[...names].filter((one) => !groups.includes(one))]) {
      if (!parts.length) break;
      const split = parts.map((part) => [...Map.groupBy(part, (facts) => facts.get(name)).values()]);
      if (split.some((levels) => levels.length > 1)) {
        factors.push(name);
        parts = split.flat().filter((part) => part.length > 1);
      }
    }
    return factors;
  }
}

// The numbers of a baseline, found for each number of another cell: same circumstances but for the
// factor of the baseline, and the same seed if both depend on one.
class Counterparts {
  constructor(numbers, [factor, level], likeness, named) {
    this.factor = factor;
    this.level = level;
    this.likeness = likeness;
    this.named = named.filter((name) => name !== factor && within(name, [factor]));
    const references = numbers.filter((n) => this.isReference(n) && Number.isFinite(n.value));
    this.references = Map.groupBy(references, (number) => this.shared(number));
  }

  isReference(number) {
    return this.likeness.runs.level(number.run, this.factor) === this.level;
  }

  shared(number) {
    const facts = [...this.likeness.facts(number)].filter(([name]) => !within(name, [this.factor]));
    return facts.map(([name, code]) => `${name}=${code}`).sort().join("\n");
  }

  pairs(numbers) {
    const pairs = new Map();
    for (const number of numbers) {
      for (const reference of this.of(number)) {
        const key = `${this.likeness.experiment(number)}|${this.likeness.experiment(reference)}`;
        pairs.set(key, [number.value, reference.value]);
      }
    }
    return [...pairs.values()];
  }

  of(number) {
    const candidates = this.references.get(this.shared(number)) ?? [];
    const seed = this.likeness.seed(number);
    return this.alike(number, candidates).filter((candidate) =>
      seed === null || [null, seed].includes(this.likeness.seed(candidate)));
  }

  // The candidates with the levels that the table names or that they differ in.
  alike(number, candidates) {
    const own = this.likeness.facts(number);
    const each = candidates.map((candidate) => this.likeness.facts(candidate));
    const names = new Set(each.flatMap((facts) =>
      [...facts.keys()].filter((name) => within(name, [this.factor]))));
    const decisive = [...names].filter((name) => name !== this.factor &&
      (this.named.includes(name) || new Set(each.map((facts) => facts.get(name))).size > 1));
    return candidates.filter((_, i) =>
      decisive.every((name) => own.get(name) === each[i].get(name)));
  }
}
