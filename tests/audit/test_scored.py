"""The benchmark's table of random logbooks agrees with a computation from the raw series."""

import random
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from seatrial.runner.compare import benchmark
from seatrial.runner.compare.frame import open_results
from seatrial.runner.compare.leaderboard import boards, summary
from seatrial.runner.configuration.search_path import CONF
from tests.audit.scored import TRIVIAL, cells, standings
from tests.runner.compare import stored

NAMES = ("surge", "sway", "yaw", "x", "y", "psi")
TASKS = ("model_ship_simulated", "ferry_simulated", "milliampere_field")  # one of each score


def fill(folder: Path, draw: random.Random) -> None:
    """Predictions of every entrant of three tasks; some fail, diverge or have none."""
    rng = np.random.default_rng(draw.randrange(1000))
    with stored.logbook_at(folder) as logbook:
        for task in map(benchmark.task_of, TASKS):
            for cell in benchmark.cells(task):
                if cell.seed > (3 if task.name == TASKS[0] else 0):
                    continue
                place = f"{cell.case} of {cell.task}"
                begin = stored.start(cell.entrant, place, cell.seed, overrides=cell.options)
                size, fate = (1 + len(cell.entrant)) * draw.choice([0.1, 0.3]), draw.random()
                columns = {"t": 2.0 * np.arange(60), "start": 1.0 * (np.arange(60) % 30 == 0)}
                columns |= dict(zip(NAMES, rng.standard_normal((6, 60)), strict=True))
                for name, end in product(NAMES, ("", *(f"_{s:g}s" for s in task.horizons_s))):
                    error = size * rng.standard_normal(60)
                    error[40:] *= 1.0 if fate > 0.03 else np.nan
                    columns[f"{name}_identified{end}"] = columns[name] + error
                    columns[f"{name}_nominal{end}"] = columns[name] + 0.5
                if 0.03 < fate < 0.06:
                    stored.fail(logbook, begin)
                else:
                    kinds = [] if 0.06 < fate < 0.08 else [stored.series("prediction", columns)]
                    stored.finish(logbook, begin, series=kinds)


@pytest.mark.parametrize("seed", range(2))
def test_every_score_of_a_random_benchmark_follows_from_its_series(
    seed: int, tmp_path: Path
) -> None:
    fill(tmp_path, random.Random(seed))
    agrees(tmp_path, TASKS)


def agrees(folder: Path, tasks: tuple[str, ...]) -> None:
    """Compare the rows of the summary with those from the raw series."""
    with open_results(f"sqlite:///{folder}/results.db") as results:
        grid = summary(boards(results, tasks))
    for name, row in zip(tasks, grid.rows, strict=True):
        path = CONF / benchmark.GROUP / f"{name}.yaml"
        rows = cells(folder / "results.db", folder, path)
        own = standings(rows, benchmark.task_of(name).score == "position")
        shown = dict(zip(grid.headers, row, strict=True))
        first = own.index[0]
        assert shown["first"].text.removesuffix(" (no skill)") == first
        assert shown["cells"].text == str(own.cells.iloc[0])
        for entrant in (first, "auto", "none", *TRIVIAL):
            cell = shown["score" if entrant == first else entrant]
            if entrant not in own.index:
                assert cell.text == "–"
                continue
            expected = own.loc[entrant]
            assert cell.sort == pytest.approx(expected.score, rel=1e-9, abs=1e-9, nan_ok=True)
            assert cell.bold == expected.best, (name, entrant)
            assert (f"({expected.lost} of" in cell.text) == (expected.lost > 0)
        if "rival" in own:
            rivals = {*shown["not significantly worse"].text.split(", ")} - {"–"}
            assert rivals == {*own.index[own.rival]}
