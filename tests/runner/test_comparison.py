"""Every identifier in calm water, noise and a constant force, from the command line to a table."""

import io
import json
import math
from contextlib import chdir, redirect_stdout
from pathlib import Path
from typing import Any

import pytest

from seatrial.runner.compare.__main__ import run as run_compare
from seatrial.runner.compare.plots import excitation, orders, pareto, surface
from tests.runner.programs import program, rows

IDENTIFIERS = ("none", "ls", "ridge", "iv", "plsr", "surface_plsr", "output_error", "nsga2", "dsr")
DISTURBANCES = ("calm", "noise", "constant")
EXACT = tuple(one for one in IDENTIFIERS if one not in ("none", "dsr"))
METRICS = (
    *("force_mse", "force_mse_filtered", "coefficient_error"),
    *(f"{what}_rmse_{ahead}" for what in ("pose", "velocity")
      for ahead in ("one_step", "ten_step", "free_run")),
)  # fmt: skip

pytestmark = [pytest.mark.nightly, pytest.mark.timeout(1800)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the sweep was run; trials that fail are kept, so its exit code is not looked at."""
    place = tmp_path_factory.mktemp("comparison")
    sweep = program(
        "-m", "runner", "-m", f"identifier={','.join(IDENTIFIERS)}",
        f"disturbance={','.join(DISTURBANCES)}", "evaluation=none", folder=place,
    )  # fmt: skip
    sweep.communicate(timeout=1700)
    assert len(rows(place, "SELECT id FROM run")) == len(IDENTIFIERS) * len(DISTURBANCES)
    return place


def compare(folder: Path, *arguments: str) -> str:
    said = io.StringIO()
    with chdir(folder), redirect_stdout(said):
        assert run_compare(list(arguments)) == 0
    return said.getvalue()


def cells(folder: Path, metric: str, dof: str) -> dict[tuple[str, str], dict[str, Any]]:
    """The table of a metric, by identifier and disturbance."""
    found = compare(
        folder, "table", "--rows", "identifier", "--columns", "disturbance", "--metric", metric,
        "--dof", dof, "--stage", "validation", "--model", "identified", "--format", "json",
    )  # fmt: skip
    return {(one["identifier"], one["disturbance"]): one for one in json.loads(found)}


@pytest.mark.parametrize("metric", METRICS)
def test_every_cell_holds_a_figure_or_its_reason(folder: Path, metric: str) -> None:
    failed = dict(rows(folder, "SELECT identifier || ' ' || disturbance, error FROM run"))
    unpredicted = rows(
        folder,
        "SELECT identifier, disturbance FROM diagnostic JOIN run ON run.id = run_id "
        "WHERE diagnostic.name = 'no_prediction' AND label LIKE 'identified%'",
    )
    for dof in ("surge", "sway", "yaw"):
        table = cells(folder, metric, dof)
        assert set(table) == {(i, d) for i in IDENTIFIERS for d in DISTURBANCES}
        for (identifier, disturbance), cell in table.items():
            if cell["n"]:
                assert math.isfinite(cell["mean"])
            elif cell["diverged_predictions"]:
                assert "_rmse_" in metric
            elif cell["failed"]:
                assert failed[f"{identifier} {disturbance}"]
            else:
                assert (identifier, disturbance) in unpredicted


def test_all_finish_and_those_that_know_the_structure_are_exact_in_calm_water(folder: Path) -> None:
    assert rows(folder, "SELECT DISTINCT status FROM run") == [("finished",)]
    for dof in ("surge", "sway", "yaw"):
        filtered = cells(folder, "force_mse_filtered", dof)
        free_run = cells(folder, "velocity_rmse_free_run", dof)
        for identifier in EXACT:
            assert filtered[identifier, "calm"]["mean"] < 1e-3 * filtered["none", "calm"]["mean"]
            assert free_run[identifier, "calm"]["mean"] < 1e-3 * free_run["none", "calm"]["mean"]


def test_a_fit_by_prediction_wins_under_noise_and_one_step_would_not_have_shown_it(
    folder: Path,
) -> None:
    """31 free terms predict badly; a step ahead they look as good as the best."""
    free_run = cells(folder, "velocity_rmse_free_run", "sway")
    one_step = cells(folder, "velocity_rmse_one_step", "sway")
    assert free_run["ls", "noise"]["mean"] > 1.5 * free_run["output_error", "noise"]["mean"]
    assert free_run["output_error", "noise"]["mean"] < 0.5 * free_run["none", "noise"]["mean"]
    assert one_step["ls", "noise"]["mean"] < 1.1 * one_step["output_error", "noise"]["mean"]
    shown = compare(folder, "table", "--metric", "velocity_rmse_one_step", "--dof", "sway")
    assert "hides bias" in shown


def test_every_coefficient_that_was_estimated_has_its_standard_error(folder: Path) -> None:
    """An equation without any is the nominal one, to which nothing better was found."""
    found = rows(
        folder,
        "SELECT identifier, count(*), count(one.std_error), sum(one.value = nominal.value) "
        "FROM coefficient AS one JOIN run ON run.id = one.run_id "
        "JOIN coefficient AS nominal USING (run_id, term, dof) "
        "WHERE one.model = 'identified' AND nominal.model = 'nominal' AND one.value <> 0 "
        "GROUP BY one.run_id, one.dof",
    )
    assert len(found) > 60
    for identifier, many, known, nominal in found:
        assert known == many or (known, nominal) == (0, many), identifier
        if identifier == "output_error":
            assert known == many


def test_the_figures_find_what_they_draw(folder: Path) -> None:
    stored = {name for (name,) in rows(folder, "SELECT DISTINCT name FROM diagnostic")}
    wanted = {pareto.OBJECTIVE, pareto.CHOSEN, excitation.SINGULAR, excitation.REAL}
    wanted |= {excitation.IMAGINARY, surface.SURFACE, surface.VARIABLES, *orders.NAMES}
    assert wanted <= stored
    for kind in ("pareto", "surface", "orders", "coefficients"):
        assert ".png" in compare(folder, "plot", kind)
    assert ".png" in compare(folder, "plot", "excitation", "--where", "identifier=dsr")
