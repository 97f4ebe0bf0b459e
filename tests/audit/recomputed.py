"""Comparison tables computed again from the raw rows of a logbook, by pandas and scipy alone.

Nothing of `seatrial.runner.compare` is imported: what a table says must follow from the tables
`run`, `metric`, `planned` and `reuse` by the rules that the guide states.
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
    trials["applies"] = ~((trials.status == "finished") & trials.run_id.isna())
    drawn = trials.drawn.fillna("null").map(json.loads)
    trials["place"] = [
        EVERY if streams == [] and status == "finished" else str(seed)
        for streams, status, seed in zip(drawn, trials.status, trials.seed, strict=True)
    ]
    return trials


def table(
    trials: pd.DataFrame, rows: str, columns: str, baseline: str, statistic: str
) -> pd.DataFrame:
    """The cells by row and column: statistic, n, lost, ratio, wins, pairs, p, Holm's p and best."""
    cells = {}
    for key, trial in trials[trials.applies].groupby([rows, columns]):
        known = trial[(trial.status == "finished") & np.isfinite(trial.value.astype(float))]
        lost = trial[~trial.index.isin(known.index)]
        cells[key] = known.groupby("place").value.last().astype(float), {*lost.seed.map(str)}
    found = []
    for (row, column), (values, lost) in cells.items():
        own = {"row": row, "column": column, "n": len(values), "lost": len(lost)}
        own["value"] = getattr(values, statistic)() if len(values) else np.nan
        reference = cells.get((baseline, column), (values[:0], set()))[0]
        if row != baseline and len(values):
            own |= _pairs(values, reference, lost)
        found.append(own)
    result = pd.DataFrame(found)
    result["p_holm"] = _holm(result.get("p", pd.Series(np.nan, result.index)))
    result["best"] = False
    for column, part in result.groupby("column"):
        reference = cells.get((baseline, column), (pd.Series(dtype=float), set()))[0]
        seeds = [place for place in reference.index if place != EVERY]
        losses = {}
        for index, cell in part.iterrows():
            values, lost = cells[cell.row, column]
            whole = EVERY in values.index or {*seeds} <= {*values.index}
            if len(values) and not lost and whole:
                chosen = values if EVERY in values.index or not seeds else values[seeds]
                losses[index] = getattr(chosen, statistic)()
        for index, loss in losses.items():
            lowest = min(losses.values())
            same = abs(loss - lowest) <= max(1e-6 * max(abs(loss), abs(lowest)), RESOLUTION)
            result.loc[index, "best"] = same and len(losses) > 1
    return result


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
    return {
        "ratio": mine.mean() / other.mean() if len(mine) else np.nan,
        "wins": int((gain > 0).sum()), "pairs": len(mine), "lost_pairs": len(gone), "p": p,
    }  # fmt: skip


def _holm(p: pd.Series) -> pd.Series:
    """Holm (1979): the k-th smallest of m is multiplied by m - k + 1, and never falls."""
    order = p.dropna().sort_values()
    steps = order * np.arange(len(order), 0, -1)
    return steps.cummax().clip(upper=1.0).reindex(p.index)
