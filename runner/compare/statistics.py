"""Statistics of cells: location, spread, intervals, the paired test, and the best of them.

`pivot` groups the frame of observations into cells; what is said of a cell is a column of `cells`.
Samples are arrays of finite numbers, shape (n,), one number for each seed. A statistic is NaN if
the sample is too small for it.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import scipy  # its subpackages are loaded at their first use
from numpy.typing import NDArray

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare import frame as frames
from seatrial.runner.compare.comparability import EVERY_SEED, by_seed, distinct, pairs, within
from seatrial.runner.record.catalogue import Better, definition_of
from seatrial.runner.record.vocabulary import DOF_ORDER, MODELS

Sample = NDArray[np.float64]
Key = tuple[str, ...]
EQUAL = 1e-6  # relative: numbers that differ by less are equal in a comparison
LEAST_PAIRS = 5  # below, no p-value of the signed-rank test is meaningful
CONFIDENCE = 0.95  # probability that an interval covers the mean
SIMPLE = ("mean", "std", "n", "median", "min", "max", "ci")
CHOICES = "mean, std, n, median, min, max, q05 ... q95 (any quantile in percent), ci"
DEFAULT = ("mean", "std", "n")
# Cells are compared with each other if they differ in nothing but these.
COMPARED = ("identifier", "controller", "update")
MARK, UNSETTLED, INFEASIBLE = "†", "‡", "§"  # below the true model; flaws of a controller's design
MARKS = {MARK: "below_true_model", UNSETTLED: "unsettled", INFEASIBLE: "infeasible"}  # of cells
BOLD_NOTE = "bold: the best under equal conditions and seeds, of cells that lost no run"
COUNTS = {reason: reason.replace(" ", "_") for reason in frames.REASONS.categories[1:]}  # of cells
COUNTS[frames.DIVERGED] = "diverged_predictions"


def checked(names: Sequence[str]) -> Key:
    """Return the distinct statistics; raises ConfigurationError for an unknown one."""
    for name in names:
        if name not in SIMPLE and not re.fullmatch(r"q\d{1,2}", name):
            raise ConfigurationError(f"--statistic: {name!r} is not known; expected {CHOICES}")
    return tuple(dict.fromkeys(names))


def summary(values: pd.DataFrame, names: Sequence[str]) -> pd.DataFrame:
    """Return the named statistics of each `cell` of the values; `ci` gives ci_low and ci_high."""
    samples = values.groupby("cell")["value"]
    found: dict[str, pd.Series[float]] = {}
    for name in names:
        if name == "ci":  # of Student's t
            half = scipy.special.stdtrit(samples.size() - 1, 0.5 + CONFIDENCE / 2) * samples.sem()
            found |= {"ci_low": samples.mean() - half, "ci_high": samples.mean() + half}
        elif name in SIMPLE:
            found[name] = samples.agg("size" if name == "n" else name)
        else:
            found[name] = samples.quantile(int(name[1:]) / 100.0)
    return pd.DataFrame(found)


def confidence_interval(sample: Sample) -> tuple[float, float]:
    """Return the 95 % interval of the mean of a sample (n,), of Student's t.

    (NaN, NaN) for fewer than two values.
    """
    of_sample = summary(pd.DataFrame({"cell": 0, "value": sample}), ["ci"]).reindex([0])
    return float(of_sample["ci_low"].item()), float(of_sample["ci_high"].item())


class PairedTest(NamedTuple):
    """Comparison of a cell with its baseline over their common seeds."""

    ratio: float  # of the means over the pairs
    difference: float  # of the means over the pairs
    p_value: float  # Wilcoxon's; NaN with fewer than LEAST_PAIRS pairs, or without differences
    p_holm: float  # after Holm's correction over the tests of a table
    effect: float  # rank-biserial correlation: 1 if better in every pair, -1 if worse in every one
    wins: int | None  # pairs in which the cell is better; None if no direction is
    pairs: int
    lost_pairs: int  # whose number the cell failed to give
    own_mean: float  # of the cell over the pairs


def equal(first: Sample, other: Sample | float, resolution: Any = 0.0) -> NDArray[np.bool_]:
    """Return where numbers (n,) differ by less than one part in a million or the resolution."""
    size = np.maximum(np.abs(first), np.abs(other))
    with np.errstate(invalid="ignore"):  # inf - inf
        near = np.abs(first - other) <= np.maximum(EQUAL * size, resolution)
    return np.asarray((first == other) | (near & np.isfinite(size)))


def least(losses: "pd.Series[float]", group: Any, resolution: Any = 0.0) -> "pd.Series[bool]":
    """Say which losses to set in bold: the least of a group in which two or more are known."""
    own = losses.groupby(group)
    lowest, several = own.transform("min").to_numpy(), own.transform("count") > 1
    return equal(losses.to_numpy(), lowest, resolution) & several


def loss(values: Sample, better: Better) -> Sample:
    """Return the values (n,) such that smaller is better: of `lower`, `higher` or a target."""
    if better == "higher":
        return -values
    if isinstance(better, int | float):
        return np.abs(values - better)
    return values


def paired_test(
    sample: Sample, baseline: Sample, better: Better = "lower", resolution: float = 0.0,
    lost: int = 0,
) -> PairedTest:  # fmt: skip
    """Compare a sample with that of a baseline, whose i-th values have the same seed and choices.

    Both have shape (n,); ValueError for different lengths. `better` is `lower`, `higher`, a target
    value, or None; values that differ by less than the `resolution` are equal, in their unit. The
    cell failed to give the value of `lost` further pairs. The effect is the rank sum of the
    positive gains less that of the negative ones, over their sum: Kerby (2014), The simple
    difference formula; 0 without differences.
    """
    gain = loss(baseline, better) - loss(sample, better)
    gain[equal(sample, baseline, resolution)] = 0.0
    wins = None if better is None else int(np.sum(gain > 0.0))
    if not sample.size:
        return PairedTest(*(math.nan,) * 5, wins, 0, lost, math.nan)
    mean, baseline_mean = float(np.mean(sample)), float(np.mean(baseline))
    ratio = mean / baseline_mean if baseline_mean != 0.0 else math.nan
    different = len({*zip(sample.tolist(), baseline.tolist(), strict=True)})
    tested = different >= LEAST_PAIRS and np.any(gain)
    p_value = float(scipy.stats.wilcoxon(gain).pvalue) if tested else math.nan
    ranks = scipy.stats.rankdata(np.abs(gain[gain != 0.0]))
    signed = float(np.sum(np.sign(gain[gain != 0.0]) * ranks))
    effect = signed / float(np.sum(ranks)) if ranks.size else 0.0
    told = ratio, mean - baseline_mean, p_value, math.nan, effect
    return PairedTest(*told, wins, int(sample.size), lost, mean)


def holm(p_values: Sequence[float]) -> list[float]:
    """Adjust p-values so that a family of tests keeps its level. Holm (1979); NaN stays NaN."""
    known = pd.Series(p_values, dtype="float64").dropna().sort_values(kind="stable")
    steps = known * np.arange(len(known), 0, -1)
    adjusted: list[float] = steps.cummax().clip(upper=1.0).reindex(range(len(p_values))).tolist()
    return adjusted


@dataclass(frozen=True)
class Pivot:
    """The cells of a table; `rows` and `columns` are its factors.

    `cells` has a row for each cell by its number, in the order of the table:
    `row` and `column`, the keys of its levels, and the `place` of the column;
    `metric` and `stage` of its numbers, the set of their `units`, `condition` of a value (or -1);
    `n` seeds with a value, `deterministic` if no value depends on one, `uneven` seeds that are left
    out since they lack a level of those that the cell pools;
    `experiments` with a value, and those `below_true_model`, which fit lag or feedback;
    the trials without a value by reason (COUNTS), and whether any is `lost`;
    `unsettled` and `infeasible`, flaws of a controller's design; `is_baseline`;
    of coefficients the root mean square `std_error`, the `true_value` if all share it, and whether
    it is an `interval_of_estimate`, not of the coefficient.

    `values` has a row for each cell and `replicate`, a seed or EVERY_SEED: the average over the
    levels that the cell pools. `known` are the distinct numbers with a value, `lost` the trials,
    started or planned, without one.
    """

    rows: Key
    columns: Key
    cells: pd.DataFrame
    values: pd.DataFrame
    known: pd.DataFrame
    lost: pd.DataFrame

    @property
    def column_keys(self) -> list[Key]:
        """The distinct keys of columns, in order."""
        return [*self.cells.sort_values("place")["column"].unique()]

    def samples(self) -> dict[int, Sample]:
        """Return the values of every cell, shape (n,)."""
        known = {cell: own.to_numpy() for cell, own in self.values.groupby("cell")["value"]}
        return {cell: known.get(cell, np.zeros(0)) for cell in self.cells.index}


def marks_of(cell: Any) -> list[str]:
    """Return the marks of a cell in tables and figures."""
    return [mark for mark, column in MARKS.items() if getattr(cell, column)]


def pivot(frame: pd.DataFrame, rows: Key, columns: Key, metrics: Sequence[str] = ()) -> Pivot:
    """Group a completed frame by the levels of the factors; every experiment counts once.

    `metrics` is the order of the metrics in the request.
    """
    frame = frame.assign(cell=frames.codes(frame, [*rows, *columns]))
    finite, own = frame["reason"] == "", frame["reason"].isin([frames.DIVERGED, frames.WITHOUT])
    known, lacking = (distinct(frame[chosen], ["cell"]) for chosen in (finite, own))
    missing = pd.concat([lacking, frame[~finite & ~own]])
    missing = missing.drop_duplicates(["cell", "reason", "run"])
    lost, means = missing[missing["reason"] != frames.NOT_APPLICABLE], by_seed(known)
    values = means[means["whole"]]
    first = frame[~frame["cell"].duplicated()].set_index("cell")
    levels = first[[*rows, *columns]].astype(str)
    usual = {"metric": metrics, "dof": DOF_ORDER, "model": MODELS, "file": (frames.POOLED,)}
    for name in levels:  # metrics as they are requested, DOFs and models as usual
        own = frames.ordered(levels[name])
        order = [level for level in usual.get(name, ()) if level in own]
        levels[name] = pd.Categorical(levels[name], [*dict.fromkeys([*order, *own])])
    levels = levels.sort_values([*columns]).assign(place=range(len(levels)))
    levels = levels.sort_values([*rows, *columns])
    cells = levels[["place"]].join(first[["metric", "stage"]].astype(str))
    for name, axis in (("row", rows), ("column", columns)):
        cells[name] = [tuple(map(str, key)) for key in levels[[*axis]].to_numpy()]
    units = frame.dropna(subset="unit").groupby("cell")["unit"].agg(frozenset).to_dict()
    cells["units"] = [units.get(cell, frozenset()) for cell in cells.index]
    observed = known.groupby("cell")
    cells["condition"] = observed["condition"].first().reindex(cells.index, fill_value=-1)
    counted = {"n": values, "uneven": means[~means["whole"]], "experiments": known}
    counted[frames.BELOW_TRUE_MODEL] = known[known[frames.BELOW_TRUE_MODEL]]
    counted |= {name: missing[missing["reason"] == why] for why, name in COUNTS.items()}
    for name, own_rows in counted.items():
        cells[name] = own_rows.groupby("cell").size().reindex(cells.index, fill_value=0)
    held = {name: known[known[name]] for name in ("unsettled", "infeasible", "is_baseline")}
    held |= {"deterministic": values[values["replicate"] == EVERY_SEED], "lost": lost}
    if "interval_of_estimate" in known:
        held["interval_of_estimate"] = known[known["interval_of_estimate"]]
        squares, truth = (known["std_error"] ** 2).groupby(known["cell"]), observed["true_value"]
        cells["std_error"] = np.sqrt(squares.mean())
        cells["true_value"] = truth.first().where(truth.nunique(dropna=False) == 1)
    for name, own_rows in held.items():
        cells[name] = cells.index.isin(own_rows["cell"])
    cells["is_baseline"] &= ~cells.index.isin(known.loc[~known["is_baseline"], "cell"])
    return Pivot(rows, columns, cells, values, known, lost)


def grouped(table: Pivot, facts: pd.DataFrame) -> pd.DataFrame:
    """Return the `group` of each cell, and how many levels that others of it pool it is `lacking`.

    The cells of a group differ in nothing but what is COMPARED, and in what they pool: `facts` that
    have several levels in some cell, but the options of what a row or column names.
    """
    cells, factors = table.cells, (*table.rows, *table.columns)
    apart = [k for k, factor in enumerate(factors) if not within(factor, (*COMPARED, "model"))]
    members = table.known[["cell", "condition"]].drop_duplicates()
    several = facts.loc[members["condition"]].groupby(members["cell"].to_numpy())
    pooled = {name for name, own in several.nunique(dropna=False).gt(1).any().items() if own}
    pooled -= {name for name in pooled if within(name, factors)}
    fixed = [name for name in facts if name not in pooled and not within(name, COMPARED)]
    groups = pd.DataFrame({"shared": cells["condition"].map(frames.codes(facts, fixed)).fillna(-1)})
    groups["levels"] = [tuple(key[k] for k in apart) for key in cells["row"] + cells["column"]]
    found = pd.DataFrame({"group": frames.codes(groups, [*groups])})
    members["level"] = members["condition"].map(frames.codes(facts, sorted(pooled)))
    members["group"] = members["cell"].map(found["group"])
    held = members.groupby("cell")["level"].nunique().reindex(cells.index)
    every = found["group"].map(members.groupby("group")["level"].nunique())
    return found.assign(lacking=(every - held).fillna(0).astype(int))


def best_cells(table: Pivot, groups: pd.DataFrame, statistic: str) -> "pd.Series[bool]":
    """Say which cells to set in bold: the best among those under equal conditions.

    Cells are compared by a statistic over the same seeds: those of the baseline, without one those
    that more than half of the cells have. A cell that lacks one of them is not best, nor is one
    that lost a trial or lacks a level, because the others are the easier ones, nor one below the
    true model, which does not fit the vessel. `groups` are those of `grouped`.
    """
    cells, group = table.cells, groups["group"]
    values = table.values.join(cells[["is_baseline"]].assign(group=group), on="cell")
    drawn = values[values["replicate"] != EVERY_SEED]
    referred = drawn.loc[drawn["is_baseline"], "group"]
    drawn = drawn[drawn["is_baseline"] | ~drawn["group"].isin(referred)]
    seeds = drawn.groupby(["group", "replicate"]).size().reset_index(name="held")
    half = seeds["group"].map(drawn.groupby("group")["cell"].nunique()) / 2.0
    seeds = seeds[seeds["group"].isin(referred) | (seeds["held"] > half)]
    values = values.merge(seeds, how="left", on=["group", "replicate"])
    values = values[values["held"].notna() | (values["replicate"] == EVERY_SEED)]
    needed = group.map(seeds.groupby("group").size()).fillna(0.0)
    whole = cells["deterministic"] | (needed == values.groupby("cell").size().reindex(group.index))
    spoilt = cells["lost"] | (cells[[frames.BELOW_TRUE_MODEL, "uneven"]] > 0).any(axis=1)
    spoilt |= groups["lacking"] > 0
    losses = summary(values, [statistic])[statistic].reindex(cells.index)
    definitions = [definition_of(metric) for metric in cells["metric"]]
    if "true_value" in cells:
        losses = (losses - cells["true_value"]).abs()
    else:  # none is best without a better direction
        each = zip(losses.to_numpy(), (one.better for one in definitions), strict=True)
        losses[:] = [math.nan if better is None else loss(v, better) for v, better in each]
    losses = losses.where(whole & ~spoilt)
    resolution = np.array([0.0 if "true_value" in cells else d.resolution for d in definitions])
    return least(losses, group, resolution)


def against_baseline(
    table: Pivot, frame: pd.DataFrame, facts: pd.DataFrame, baseline: Mapping[str, str]
) -> dict[int, PairedTest]:
    """Test each cell against its counterparts in the frame, which have the levels of `baseline`.

    Cells of the baseline itself are omitted; a cell without a counterpart has a test without pairs.
    A cell that lost every trial lost a pair for each seed that the baseline has at its levels.
    """
    factors = (*table.rows, *table.columns)
    named = [name for name in factors if name not in baseline and name not in frames.METRIC_FACTORS]
    references = distinct(frame[(frame["reason"] == "") & frame["is_baseline"]]).assign(cell=-1)
    own = table.known[~table.known["is_baseline"]]
    both = pd.concat([own, references], ignore_index=True)
    beside, seeds = pairs(both, facts, baseline, named)
    of_cell = dict(iter(beside.groupby("cell")))
    known = seeds.groupby("cell")["replicate"].agg(set).to_dict()
    lost_seeds = table.lost.groupby("cell")["seed"].agg(set)
    same = [name for name in (*named, *frames.METRIC_FACTORS) if name not in baseline]
    if "model" in baseline:  # that depends on no identifier
        same = [name for name in same if not within(name, ["identifier"])]
    failed = table.lost[~table.lost["cell"].isin(table.known["cell"])]
    failed = failed[(failed[[*baseline]].astype(str) != pd.Series(baseline)).any(axis=1)]
    levels = failed[same].astype(str).assign(cell=failed["cell"]).drop_duplicates()
    levels = levels.merge(references[[*same, "replicate"]].astype(str), on=same)
    known |= levels.groupby("cell")["replicate"].agg(set).to_dict()
    tests = {}
    for number in sorted({*own["cell"], *known}):
        pair, of_baseline = of_cell.get(number, beside[:0]), known.get(number, set())
        lost = lost_seeds.get(number, set())  # also those of which another pooled level has a value
        pair = pair[~pair["replicate"].isin(lost)]
        lost &= lost if EVERY_SEED in of_baseline else of_baseline
        metric, stage = table.cells.loc[number, ["metric", "stage"]]
        definition = definition_of(metric)
        resolution = 0.0 if stage == frames.COEFFICIENT_STAGE else definition.resolution
        samples = pair["value"].to_numpy(), pair["other"].to_numpy()
        tests[number] = paired_test(*samples, definition.better, resolution, len(lost))
    adjusted = holm([test.p_value for test in tests.values()])
    each = zip(tests.items(), adjusted, strict=True)
    return {number: test._replace(p_holm=p) for (number, test), p in each}
