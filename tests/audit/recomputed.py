"""Comparison tables computed again from the raw rows of a logbook, by pandas and scipy alone.

Nothing of `seatrial.runner.compare` is imported: what a table says must follow from the tables
`run`, `metric`, `planned` and `reuse` by these laws.

- A trial counts once, by its last finished attempt, else by its last one; one that was planned and
  has no run never started. What has no finite value is lost, by its reason. A finished trial
  without such a row is one whose method has no such number: it is not applicable, and lost nothing.
- A trial that drew no random stream is of every seed, and all like it are one experiment.
- Two numbers that differ by no more than a millionth or the resolution are equal.
- The baseline is compared with over the seeds that both have. A pair that a cell lost is not won.
- p is Wilcoxon's of at least five distinct pairs, and Holm's over the table; r is the share of the
  rank sum that is for the cell less that against it (Kerby, 2014).
- Best is the least of several cells of a column over the same seeds: those of the baseline, without
  a baseline those that most cells have. Who lacks one of them or lost a trial does not take part,
  and a cell without a rival is the best of nothing.
"""

import json
import sqlite3
from pathlib import Path

import numpy as np
import pandas as pd
import scipy.stats

LEAST_PAIRS = 5
RESOLUTION = 1e-6  # [m]
EVERY = "every seed"  # of a number that depends on none


def frame(database: Path, metric: str, dof: str, sweep: int) -> pd.DataFrame:
    """One row for each trial that the sweep ran, reused or planned, with its value or none."""
    with sqlite3.connect(database) as connection:
        run, rows, planned, reuse = (
            pd.read_sql(f"SELECT * FROM {name}", connection)
            for name in ("run", "metric", "planned", "reuse")
        )
    order = run.assign(done=run.status == "finished").sort_values(["done", "attempt"])
    run = order.groupby("fingerprint").tail(1)  # a finished attempt, else the last one
    reused = reuse.loc[reuse.sweep_id == sweep, "run_id"]
    run = run[(run.sweep_id == sweep) | run.id.isin(reused)]
    own = rows[(rows.name == metric) & (rows.dof == dof) & (rows.model == "identified")]
    trials = run.merge(own[["run_id", "value"]], left_on="id", right_on="run_id", how="left")
    waiting = planned[(planned.sweep_id == sweep) & ~planned.fingerprint.isin(order.fingerprint)]
    choices = pd.DataFrame([json.loads(text) for text in waiting.choices], index=waiting.index)
    absent = choices.assign(seed=waiting.seed, status="not started", drawn="null")
    trials = pd.concat([trials, absent], ignore_index=True)
    finished = trials.status == "finished"
    valid = np.isfinite(trials.value.astype(float))
    trials["reason"] = trials.status.where(~finished, "without value").str.replace(" ", "_")
    trials.loc[finished & trials.run_id.isna(), "reason"] = "not_applicable"
    trials.loc[finished & valid, "reason"] = ""
    drawn = trials.drawn.fillna("null").map(json.loads)
    trials["place"] = [
        EVERY if streams == [] and done else str(seed)
        for streams, done, seed in zip(drawn, finished, trials.seed, strict=True)
    ]
    return trials


def table(
    trials: pd.DataFrame, rows: str, columns: str, baseline: str | None, statistic: str
) -> pd.DataFrame:
    """The cells: statistic, counts, ratio, wins, pairs, p, Holm's p, effect, and which is best."""
    cells, found = {}, []
    for (row, column), trial in trials.groupby([rows, columns]):
        known = trial[trial.reason == ""].drop_duplicates("place", keep="last").set_index("place")
        values = known.value.astype(float)
        lost = {*trial.seed[~trial.reason.isin(["", "not_applicable"])].map(str)}
        cells[row, column] = values, lost
        own = {"row": row, "column": column, "n": len(values)}
        found.append(own | trial.reason[trial.reason != ""].value_counts().to_dict())
    nothing = (pd.Series(dtype=float), set())
    for own in found:
        values, lost = cells[own["row"], own["column"]]
        own["value"] = getattr(values, statistic)() if len(values) else np.nan
        reference = cells.get((baseline, own["column"]), nothing)[0]
        if baseline and own["row"] != baseline and (len(values) or (lost and len(reference))):
            own |= _pairs(values, reference, lost)
    result = pd.DataFrame(found)
    result["p_holm"] = _holm(result.get("p", pd.Series(np.nan, result.index)))
    result["best"] = False
    for column, part in result.groupby("column"):
        samples = {index: cells[cell.row, column] for index, cell in part.iterrows()}
        seeds = _seeds([own for own, _ in samples.values()], cells.get((baseline, column)))
        losses = {
            index: getattr(values if EVERY in values.index else values[seeds], statistic)()
            for index, (values, lost) in samples.items()
            if len(values) and not lost and (EVERY in values.index or {*seeds} <= {*values.index})
        }
        for index, loss in losses.items():
            lowest = min(losses.values())
            same = abs(loss - lowest) <= max(1e-6 * max(abs(loss), abs(lowest)), RESOLUTION)
            result.loc[index, "best"] = same and len(losses) > 1
    return result


def _seeds(samples: list[pd.Series], baseline: tuple[pd.Series, set[str]] | None) -> list[str]:
    """The seeds of the baseline; without one those that more than half of the cells have."""
    if baseline is not None and len(baseline[0]):
        return [place for place in baseline[0].index if place != EVERY]
    drawn = [[*own.index] for own in samples if {*own.index} - {EVERY}]
    places = sorted({place for own in drawn for place in own} - {EVERY})
    return [place for place in places if 2 * sum(place in own for own in drawn) > len(drawn)]


def _pairs(values: pd.Series, reference: pd.Series, lost: set[str]) -> dict[str, float]:
    """The comparison of a cell with the baseline over the seeds that both have."""
    places = [*values.index] if EVERY in reference.index else [*reference.index]
    if EVERY not in values.index and EVERY not in reference.index:
        places = [place for place in values.index if place in reference.index]
    mine = np.array([values.get(place, values.get(EVERY)) for place in places], dtype=float)
    other = np.array([reference.get(place, reference.get(EVERY)) for place in places], dtype=float)
    gain = other - mine
    gain[np.abs(gain) <= np.maximum(1e-6 * np.maximum(abs(mine), abs(other)), RESOLUTION)] = 0.0
    known = {*reference.index}
    gone = {seed for seed in lost - {*places} if seed in known or EVERY in known}
    distinct = len({*zip(mine, other, strict=True)})
    p = scipy.stats.wilcoxon(gain).pvalue if distinct >= LEAST_PAIRS and np.any(gain) else np.nan
    moved = gain[gain != 0.0]
    ranks = pd.Series(abs(moved)).rank().to_numpy()
    effect = (ranks[moved > 0].sum() - ranks[moved < 0].sum()) / ranks.sum() if len(moved) else 0.0
    return {
        "ratio": mine.mean() / other.mean() if len(mine) else np.nan,
        "difference": mine.mean() - other.mean() if len(mine) else np.nan,
        "effect": effect if len(mine) else np.nan,
        "wins": int((gain > 0).sum()), "pairs": len(mine), "lost_pairs": len(gone), "p": p,
    }  # fmt: skip


def _holm(p: pd.Series) -> pd.Series:
    """Holm (1979): the k-th smallest of m is multiplied by m - k + 1, and never falls."""
    order = p.dropna().sort_values()
    steps = order * np.arange(len(order), 0, -1)
    return steps.cummax().clip(upper=1.0).reindex(p.index)
