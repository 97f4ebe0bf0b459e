"""The benchmark's table computed again from raw rows, Parquet files and the tasks' YAML files.

Nothing of `seatrial.runner.compare` is imported. The laws: the newest run of a cell counts. Its
error is relative to the spread of what was measured in its file, or of a position in metres; the
loss of a cell is the mean over the outputs of the root mean square, infinite for a run that failed
or cannot predict to the end. FIT is 100 (1 - loss) % of all samples that an entrant predicted, the
score of a position the mean of its losses. Entrants are ranked over the cells that all have run,
without the trivial ones; best is the best score of several that lost no cell. Who has a p of at
least 0.05 (Wilcoxon's on ranks, after Holm's correction of all pairs) is not significantly worse,
where so many cells can tell.
"""

import json
import re
import sqlite3
from collections.abc import Iterable, Mapping
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import scipy.stats
import yaml

TRIVIAL = ("mean_motion", "persistence", "at_rest")
NO_RESULT = ("results_dir", "sweep.", "hydra", "database", "dry_run", "rerun")


def key(texts: Iterable[str]) -> frozenset[tuple[str, str]]:
    """The options of a trial, the last of each name, without folders, quotes and spaces."""
    pairs = dict(text.split("=", 1) for text in texts)
    shown = {name: re.sub(r"[^\[\],]*/|['\" ]", "", value) for name, value in pairs.items()}
    return frozenset((n, value) for n, value in shown.items() if not n.startswith(NO_RESULT))


def errors(frame: pd.DataFrame, model: str, task: Mapping[str, Any]) -> np.ndarray:
    """The errors (N, n) of a model where some model has a prediction."""
    kind, after = task.get("score", "free_run"), task.get("horizons_s", (1.0, 10.0, 60.0))[-1]
    names = ["x", "y"] if kind == "position" else task["outputs"]
    end = "" if kind == "free_run" else f"_{after:g}s"
    measured = frame[names].to_numpy(float)
    use, begin = np.ones(len(frame), dtype=bool), frame.index.to_series()
    begin = begin.where(frame.start > 0).ffill().astype(int).to_numpy()
    if end:
        use = frame[[name for name in frame if name.endswith(end)]].notna().any(axis=1).to_numpy()
        begin = np.roll(np.arange(len(frame)), round(after / np.median(np.diff(frame.t))))
    predicted = before = measured[begin]
    if model == "mean_motion" and kind == "position":
        predicted = before + (measured - before)[use].mean(axis=0)
    elif model == "mean_motion":
        predicted = np.broadcast_to(measured.mean(axis=0), measured.shape)
    elif model == "persistence" and kind == "position":
        u, v, psi = frame[["surge", "sway", "psi"]].to_numpy(float)[begin].T
        velocity = [u * np.cos(psi) - v * np.sin(psi), u * np.sin(psi) + v * np.cos(psi)]
        predicted = before + after * np.column_stack(velocity)
    elif model not in TRIVIAL:
        predicted = frame[[f"{name}_{model}{end}" for name in names]].to_numpy(float)
    error = (predicted - measured)[use]
    return np.hypot(*error.T)[:, None] if kind == "position" else error / measured.std(axis=0)


def _rms(error: np.ndarray) -> np.ndarray:
    values = np.sqrt(np.mean(error**2, axis=0))
    return np.where(np.isfinite(values), values, np.inf)


def cells(database: Path, folder: Path, path: Path, maps: str = "map test_map") -> pd.DataFrame:
    """The cells of a task that have been run: case, seed, entrant, errors, loss."""
    task, found = yaml.safe_load(path.read_text()), {}
    with sqlite3.connect(database) as connection:
        runs = pd.read_sql("SELECT id, status, overrides FROM run ORDER BY id", connection)
        series = pd.read_sql("SELECT * FROM series WHERE kind = 'prediction'", connection)
    newest = dict(zip((key(json.loads(o)) for o in runs.overrides), runs.itertuples(), strict=True))
    files, horizons = series.set_index("run_id").path, task.get("horizons_s", (1.0, 10.0, 60.0))
    for entrant, own in task["entrants"].items():
        for label, case in task["cases"].items():
            texts = [f"excitation.{n}={task[n]}" for n in maps.split() if n in task]
            texts += [f"excitation.{n}={case[n]}" for n in ("train", "test") if n in case]
            texts = [*task["trial"], *texts, *case.get("options", ()), *own]
            texts.append(f"horizons_s={[float(s) for s in horizons]}")
            for seed in range(case.get("seeds") or task.get("seeds", 1)):
                run = newest.get(key([*texts, f"seed={seed}"]))
                if run is not None:
                    found[label, seed, entrant] = None
                if run is not None and run.status == "finished" and run.id in files.index:
                    only = [("kind", "==", "prediction")]
                    frame = pd.read_parquet(folder / files[run.id], filters=only)
                    found[label, seed, entrant] = errors(frame, "identified", task)
                    for name in TRIVIAL[: 3 if task.get("score") == "position" else 2]:
                        found.setdefault((label, seed, name), errors(frame, name, task))
    rows = pd.Series(found, dtype=object).rename_axis(["case", "seed", "entrant"])
    rows = rows.reset_index(name="errors")
    of_cell = lambda e: np.inf if e is None or not len(e) else _rms(e).mean()  # noqa: E731
    return rows.assign(loss=rows["errors"].map(of_cell))


def standings(rows: pd.DataFrame, is_position: bool) -> pd.DataFrame:
    """By entrant, the first one first: score, lost, best, and whether not significantly worse."""
    own = rows.groupby("entrant")
    result = pd.DataFrame({"lost": own.loss.agg(lambda loss: np.isinf(loss).sum())})
    for name, entries in own:
        good = entries[np.isfinite(entries.loss)]
        score = good.loss.mean() if is_position or good.empty else np.nan
        if not is_position and len(good):
            score = 100.0 * (1.0 - _rms(np.concatenate([*good["errors"]])).mean())
        result.loc[name, "score"] = score
    whole = (result.lost == 0) & (own.size() == own.size().max()) & ~result.index.isin(TRIVIAL)
    order = result.score[whole].sort_values(ascending=is_position)
    result["best"] = result.index.isin(order.index[: len(order) > 1])
    losses = rows.pivot(index=["case", "seed"], columns="entrant", values="loss").dropna()
    ranks = losses.drop(columns=[*TRIVIAL], errors="ignore").rank(axis=1)
    result["rank"] = ranks.mean()
    result = result.sort_values("rank", kind="stable")
    first, pairs, p = result.index[0], [*combinations(ranks.columns, 2)], []
    if 0.5 ** (len(ranks) - 1) * len(pairs) < 0.05:
        for one, other in pairs:
            gain = ranks[one] - ranks[other]
            p.append(scipy.stats.wilcoxon(gain, zero_method="zsplit").pvalue if any(gain) else 1.0)
        steps = pd.Series(p, pd.Index(pairs)).sort_values()
        adjusted = (steps * np.arange(len(steps), 0, -1)).cummax()
        near = {name for pair in pairs if first in pair and adjusted[pair] >= 0.05 for name in pair}
        result["rival"] = [name in near and name != first for name in result.index]
    return result.assign(cells=len(ranks))
