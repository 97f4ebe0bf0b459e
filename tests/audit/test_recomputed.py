"""Tables of random logbooks agree in every cell with a computation from the raw rows."""

import random
from pathlib import Path

import numpy as np
import pytest

from seatrial.runner.compare.cli import TableOptions
from seatrial.runner.compare.frame import open_results
from seatrial.runner.compare.table import comparison
from tests.audit.recomputed import frame, table
from tests.runner.compare import stored

SAME = {"value": "median", "p": "p_value"}
SAME |= {name: name for name in ("ratio", "difference", "effect", "p_holm")}
COUNTS = ("failed", "without_value", "not_applicable", "not_started")
EQUAL = ("n", *COUNTS, "wins", "pairs", "lost_pairs", "best")


def fill(folder: Path, draw: random.Random) -> None:
    """One sweep of four identifiers in three weathers, with all that a night can do to it."""
    with stored.logbook_at(folder) as logbook:
        begins = [
            stored.start(identifier, disturbance, seed)
            for identifier in ("none", "ls", "plsr", "iv")
            for disturbance in ("calm", "noise", "wind")
            for seed in range(8 if disturbance != "calm" else 1)
        ]
        trials = stored.planned(begins)
        sweep = logbook.begin_sweep("night", "command", [], len(trials), trials=trials)
        size = {name: draw.choice([0.3, 1.0, 1.0]) for name in ("none", "ls", "plsr", "iv")}
        for begin in begins:
            fate = draw.random()
            if fate < 0.04:
                continue
            if fate < 0.08:
                begun = logbook.begin_run(begin, sweep)
                logbook.fail_run(begun.run_id, "failed", "ValueError", "broken", "Traceback")
                continue
            level = size[begin.identifier] * (1.0 + draw.choice([0.0, 1e-9, 0.2]) * begin.seed)
            value = float("nan") if fate < 0.11 else level
            metrics = [] if 0.11 < fate < 0.13 else [stored.tracking(value)]
            streams = () if begin.disturbance == "calm" else ("noise",)
            stored.finish(logbook, begin, metrics, drawn=streams, sweep=sweep)


def agrees(folder: Path, cells: int, baseline: str | None = "none") -> None:
    """Compare the table of tracking errors of sweep 1 with one from the raw rows."""
    expected = table(
        frame(folder / "results.db", "e_pos_mae", "position", 1),
        "identifier", "disturbance", baseline, "median",
    )  # fmt: skip
    expected = expected.reindex(columns=[*{*expected, *COUNTS, *SAME, *EQUAL}])
    expected = expected.fillna(dict.fromkeys(COUNTS, 0))
    against = [f"identifier={baseline}"] if baseline else None
    asked = TableOptions(
        metric=["e_pos_mae"], statistic=["median", "n"], baseline=against, sweep="1"
    )
    with open_results(f"sqlite:///{folder}/results.db") as results:
        records = comparison(results, asked).as_records()
    shown = {(r["identifier"], r["disturbance"]): r for r in records}
    assert len(expected) == len(shown) >= cells
    for cell in expected.to_dict("records"):
        record = shown[cell["row"], cell["column"]]
        for mine, theirs in SAME.items():
            other = record.get(theirs)
            other = float("nan") if other is None else other
            assert cell[mine] == pytest.approx(other, rel=1e-9, nan_ok=True), (mine, cell, record)
        for name in EQUAL:
            if not (record.get(name) is None and np.isnan(cell[name])):
                assert cell[name] == record[name], (name, cell, record)


@pytest.mark.parametrize("baseline", ["none", None])
@pytest.mark.parametrize("seed", range(10))
def test_every_cell_of_a_random_table_follows_from_the_raw_rows(
    seed: int, baseline: str | None, tmp_path: Path
) -> None:
    fill(tmp_path, random.Random(seed))
    agrees(tmp_path, 10, baseline)
