"use strict";
// Statistics over seeds, as runner/compare/statistics.py computes them.
const SAME = 1e-9; // relative: smaller differences are rounding errors
const LEAST_PAIRS = 5;
const EXACT_UP_TO = 50; // pairs of the exact signed-rank test, without ties
const EXACT_WITH_TIES = 13;

const statistics = {
  mean(values) {
    return values.length ? values.reduce((sum, value) => sum + value, 0) / values.length : NaN;
  },

  // With n - 1 in the denominator.
  std(values) {
    if (values.length < 2) return NaN;
    const mean = statistics.mean(values);
    const squares = values.reduce((sum, value) => sum + (value - mean) ** 2, 0);
    return Math.sqrt(squares / (values.length - 1));
  },

  // Student's t within which 95 % lie; beyond the table Abramowitz and Stegun, eq. 26.7.5.
  quantile(table, freedom) {
    if (freedom <= table.length) return table[freedom - 1];
    const z = 1.959963984540054, v = freedom;
    return z + (z ** 3 + z) / (4 * v) + (5 * z ** 5 + 16 * z ** 3 + 3 * z) / (96 * v ** 2) +
      (3 * z ** 7 + 19 * z ** 5 + 17 * z ** 3 - 15 * z) / (384 * v ** 3) +
      (79 * z ** 9 + 776 * z ** 7 + 1482 * z ** 5 - 1920 * z ** 3 - 945 * z) / (92160 * v ** 4);
  },

  // The 95 % interval of the mean; [NaN, NaN] for fewer than two values.
  interval(values, table) {
    if (values.length < 2) return [NaN, NaN];
    const mean = statistics.mean(values);
    const half = statistics.quantile(table, values.length - 1) * statistics.std(values) /
      Math.sqrt(values.length);
    return [mean - half, mean + half];
  },

  // Smaller is better; `better` is lower, higher, a number or null.
  loss(value, better) {
    if (better === "higher") return -value;
    return typeof better === "number" ? Math.abs(value - better) : value;
  },

  // Pairs of values and the baseline's: pairs, wins, ratio, difference, p.
  pairedTest(pairs, better) {
    const gains = pairs.map(([own, other]) =>
      statistics.loss(other, better) - statistics.loss(own, better));
    const own = statistics.mean(pairs.map((pair) => pair[0]));
    const other = statistics.mean(pairs.map((pair) => pair[1]));
    const distinct = new Set(pairs.map(String)).size;
    return {
      pairs: pairs.length,
      wins: better === null ? null : gains.filter((gain) => gain > 0).length,
      ratio: other === 0 ? NaN : own / other,
      difference: own - other,
      mean: own,
      p: distinct >= LEAST_PAIRS ? statistics.signedRank(gains) : NaN,
    };
  },

  // p of the two-sided Wilcoxon signed-rank test; zeros are left out. NaN without differences.
  signedRank(differences) {
    const kept = differences.filter((difference) => difference !== 0);
    if (!kept.length) return NaN;
    const { ranks, groups } = averageRanks(kept.map(Math.abs));
    const plus = ranks.reduce((sum, rank, i) => sum + (kept[i] > 0 ? rank : 0), 0);
    const tied = groups.some((size) => size > 1) || kept.length < differences.length;
    if (differences.length <= (tied ? EXACT_WITH_TIES : EXACT_UP_TO)) {
      return exactProbability(ranks, plus);
    }
    const n = kept.length;
    const ties = groups.reduce((sum, size) => sum + size ** 3 - size, 0);
    const deviation = Math.sqrt((n * (n + 1) * (2 * n + 1) - ties / 2) / 24);
    return complementaryError(Math.abs(plus - n * (n + 1) / 4) / deviation / Math.SQRT2);
  },
};

function averageRanks(values) {
  const order = values.map((_, i) => i).sort((a, b) => values[a] - values[b]);
  const ranks = new Array(values.length), groups = [];
  for (let first = 0; first < order.length;) {
    let last = first;
    while (last + 1 < order.length && values[order[last + 1]] === values[order[first]]) last += 1;
    for (let i = first; i <= last; i += 1) ranks[order[i]] = (first + last) / 2 + 1;
    groups.push(last - first + 1);
    first = last + 1;
  }
  return { ranks, groups };
}

// Twice the smaller tail over all signs of the ranks, at most 1.
function exactProbability(ranks, plus) {
  const doubled = ranks.map((rank) => Math.round(2 * rank));
  let counts = [1];
  for (const rank of doubled) {
    const next = new Array(counts.length + rank).fill(0);
    counts.forEach((count, sum) => {
      next[sum] += count / 2;
      next[sum + rank] += count / 2;
    });
    counts = next;
  }
  const at = Math.round(2 * plus);
  const below = counts.slice(0, at + 1).reduce((sum, share) => sum + share, 0);
  const above = counts.slice(at).reduce((sum, share) => sum + share, 0);
  return Math.min(1, 2 * Math.min(below, above));
}

// erfc(x) for x >= 0 to 1.2e-7 of its value: Press et al., Numerical Recipes (1992), section 6.2.
function complementaryError(x) {
  const t = 1 / (1 + 0.5 * x);
  const terms = [-1.26551223, 1.00002368, 0.37409196, 0.09678418, -0.18628806, 0.27886807,
    -1.13520398, 1.48851587, -0.82215223, 0.17087277];
  const sum = terms.reduceRight((total, term) => total * t + term, 0);
  return t * Math.exp(-x * x + sum);
}
