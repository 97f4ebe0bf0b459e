"""What holds of a figure whatever its data: one vessel, hulls to scale, limits at their value."""

from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from seatrial.models.diagnostics import Diagnostic
from seatrial.runner.compare.frame import Queries, open_results
from seatrial.runner.compare.plots.track import LEAST_SHARE, drawn_length, outline
from seatrial.runner.database import LogbookWriter
from seatrial.runner.record.rows import Series
from tests.runner.compare import stored
from tests.runner.compare.drawing import axes_of, drawings, limits, line, notes

T = np.arange(0.0, 100.0, 0.5)


def heading(figure: Figure) -> str:
    title = figure.legends[0].get_title() if figure.legends else figure._suptitle  # type: ignore[attr-defined]
    return " ".join(title.get_text().split())


@pytest.mark.parametrize(
    ("kind", "rows"), [("coefficients", "identifier"), ("coefficients", "vessel"), ("bars", "")]
)
def test_a_figure_has_one_vessel(
    logbook: LogbookWriter, results: Queries, kind: str, rows: str
) -> None:
    """Also where no mean would mix them: each vessel has an identifier of its own."""
    for vessel, identifier in (("milliampere", "ls"), ("supply_vessel", "plsr")):
        run = stored.start(identifier, vessel=vessel)
        found = [stored.coefficient("u_dot", 1000.0, 5.0, 1000.0)]
        stored.finish(logbook, run, [stored.force_mse(4.0)], found)
    titles = [heading(one.figure) for one in drawings(kind, results, rows=rows)]
    assert ["milliampere" in title for title in titles] == [True, False]
    assert ["supply_vessel" in title for title in titles] == [False, True]


def test_coefficients_name_the_trials_that_were_lost(
    logbook: LogbookWriter, results: Queries
) -> None:
    found = [stored.coefficient("u_dot", 1000.0, 5.0, 1000.0)]
    stored.finish(logbook, stored.start("ls"), coefficients=found)
    for seed in range(3):
        stored.fail(logbook, stored.start("plsr", seed=seed))
    (drawing,) = drawings("coefficients", results)
    assert "trials that were lost: 3 of plsr" in notes(drawing.figure)


@pytest.mark.parametrize("polished", [False, True])
def test_a_front_shows_the_deployed_model_where_a_polish_has_moved_it(
    logbook: LogbookWriter, results: Queries, polished: bool
) -> None:
    front = np.array([[1.0, 4.0], [2.0, 2.0], [4.0, 1.0]])
    deployed = np.array([1.5, 1.5]) if polished else front[1]
    rows = [
        Diagnostic("pareto_objective", "all", value, "m", i=i, j=j, label=f"error {j}")
        for (i, j), value in np.ndenumerate(front)
    ]
    rows.append(Diagnostic("pareto_chosen", "all", 1.0, i=1))
    rows += [Diagnostic("objective", "all", v, "m", j=j) for j, v in enumerate(deployed)]
    stored.finish(logbook, stored.start("nsga2"), diagnostics=rows)
    axes, *_ = axes_of("pareto", results)
    rings = [
        (one.get_marker(), *np.ravel(one.get_xydata()))
        for one in axes.lines
        if one.get_fillstyle() == "none"
    ]
    assert rings == [("o", 2.0, 2.0), *([("D", 1.5, 1.5)] if polished else [])]


def test_one_seed_has_no_whisker_and_no_whisker_reaches_the_floor(
    logbook: LogbookWriter, results: Queries
) -> None:
    stored.finish(logbook, stored.start("none"), [stored.force_mse(5000.0)])
    for seed, value in enumerate((1.0, 1.0, 100.0)):  # deviation above the mean
        stored.finish(logbook, stored.start("ls", seed=seed), [stored.force_mse(value)])
    (axes,) = axes_of("bars", results)
    assert axes.get_yscale() == "log"
    (whisker,) = [s for lines in axes.collections for s in lines.get_segments()]
    deviation = np.std([1.0, 1.0, 100.0], ddof=1)
    np.testing.assert_allclose(whisker[:, 1], [34.0, 34.0 + deviation])


def test_a_hull_is_a_whole_multiple_of_the_vessel_and_can_be_seen() -> None:
    for length, extent in product((0.8, 5.0, 73.2, 320.0), (10.0, 400.0, 5e4)):
        drawn_m, note = drawn_length({"vessel": {"length_m": length}}, extent)
        times = drawn_m / length
        assert times == pytest.approx(round(times))
        assert drawn_m >= LEAST_SHARE * extent
        assert (times == 1.0) == (length >= LEAST_SHARE * extent)
        assert f"{round(times)} times" in note if times > 1.0 else "to scale" in note


def test_an_outline_has_the_length_and_the_heading_of_the_vessel() -> None:
    for psi in np.linspace(-3.0, 3.0, 7):
        bow, _, right, left, _ = outline(10.0, -20.0, psi, 42.0)
        ahead = bow - 0.5 * (left + right)  # east, north
        assert np.hypot(*ahead) == pytest.approx(42.0)
        assert np.arctan2(*ahead) == pytest.approx(psi)


def voyage(model: str, radius: float) -> Series:
    angle = 2.0 * np.pi * T / T[-1]
    columns = {"t": T, "x": radius * np.sin(angle), "y": radius * np.cos(angle), "psi": -angle}
    columns |= {"tau_surge": 2e5 * np.sin(angle), "e_pos": np.full_like(T, 1.0)}
    columns |= {f"{name}_d": columns[name] for name in ("x", "y", "psi")}
    return stored.series(f"deployment_{model}", columns)


def sail(logbook: LogbookWriter, identified: float | None) -> None:
    vessel = {"length_m": 50.0, "dofs": ["surge"], "force_limits": [2.5e5]}
    series = [voyage("nominal", 200.0)]
    series += [] if identified is None else [voyage("identified", identified)]
    stored.finish(logbook, stored.start(config={"vessel": vessel}), series=series)


@pytest.mark.parametrize("kind", ["track", "errors", "response"])
@pytest.mark.parametrize(
    ("identified", "said"), [(None, "did not sail"), (200.0, "sails the same track"), (190.0, "")]
)
def test_a_model_that_did_not_sail_is_not_one_that_sails_alike(
    logbook: LogbookWriter, results: Queries, kind: str, identified: float | None, said: str
) -> None:
    sail(logbook, identified)
    (drawing,) = drawings(kind, results)
    assert ("the identified model" in notes(drawing.figure)) == bool(said)
    assert said in notes(drawing.figure)


def test_a_controller_that_was_lost_is_named_beside_those_that_sailed(
    logbook: LogbookWriter, results: Queries
) -> None:
    for controller in ("lqi", "mpc_integral"):
        begin = stored.start(controller=controller)
        stored.finish(logbook, begin, series=[voyage("identified", 200.0)])
    stored.fail(logbook, stored.start(controller="pid_ff"), "diverged")
    (drawing,) = drawings("response", results, rows="controller")
    assert "not shown: pid_ff: diverged" in notes(drawing.figure)


def test_bars_mark_lost_runs_and_unstable_designs_as_tables_do(
    logbook: LogbookWriter, results: Queries
) -> None:
    """Also on a logarithmic axis, and of a trial that was planned alone."""
    begins = [stored.start(name) for name in ("none", "ls", "plsr", "iv")]
    plan = stored.planned(begins)
    sweep = logbook.begin_sweep("night", "command", [], 4, trials=plan)
    for begin, value, radius in zip(begins, (1.0, 900.0), (0.9, 1.1), strict=False):
        metrics = [stored.tracking(value), stored.deployed("spectral_radius", radius)]
        stored.finish(logbook, begin, metrics, sweep=sweep)
    stored.fail(logbook, begins[2])
    (axes,) = axes_of("bars", results, metric="e_pos_mae", sweep="all")
    assert axes.get_yscale() == "log"
    texts = {text.get_text(): text for text in axes.texts}
    assert texts.keys() == {"‡", "1 failed", "1 not started"}
    assert "‡ the controller is not stable" in notes(axes.figure)
    frame = axes.get_window_extent()
    assert all(frame.overlaps(text.get_window_extent()) for text in texts.values())


def test_forces_of_ships_are_in_kilonewtons_with_their_limits(
    logbook: LogbookWriter, results: Queries
) -> None:
    sail(logbook, 201.0)
    _, force = axes_of("response", results)
    assert force.get_ylabel() == "Force, surge [kN]"
    assert np.max(line(force, "nominal model")[:, 1]) == pytest.approx(200.0, rel=1e-3)
    assert limits(force) == [-250.0, 250.0]


LIMIT = float(np.radians(35.0))
HELM = {"delta": {"low": -LIMIT, "high": LIMIT}}


def test_inputs_of_a_steered_vessel_have_an_excitation(
    logbook: LogbookWriter, results: Queries
) -> None:
    delta = np.radians(20.0) * np.sign(np.sin(0.2 * T))
    columns = {"t": T, "delta": 0.9 * delta, "delta_command": delta, "n": 10.0 + 0.0 * T}
    vessel = {"dofs": ["surge"], "inputs": HELM | {"n": {"low": 0.0, "high": 20.0}}}
    begin = stored.start(config={"vessel": vessel})
    stored.finish(logbook, begin, series=[stored.series("recording", columns)])
    helm, _ = axes_of("excitation", results)
    assert helm.get_ylabel() == "delta [deg]"
    assert helm.get_title(loc="left") == "peak 20.0 deg, 57% of the limit"
    assert np.max(line(helm, "commanded")[:, 1]) == pytest.approx(20.0)
    assert np.max(line(helm, "acting")[:, 1]) == pytest.approx(18.0)
    assert limits(helm) == pytest.approx([-35.0, 35.0])
    assert "constant: n 10.0 1/s" in notes(helm.figure)


def test_a_steered_vessel_responds_with_heading_and_inputs(
    logbook: LogbookWriter, results: Queries
) -> None:
    course = 170.0 + 40.0 * T / T[-1]  # across 180 degrees
    psi = np.radians(course)
    columns = {"t": T, "x": T, "y": T, "psi": np.angle(np.exp(1j * psi)), "psi_d": psi}
    columns |= {"delta": np.full_like(T, 0.5), "delta_command": np.full_like(T, LIMIT)}
    begin = stored.start(config={"vessel": {"inputs": HELM}})
    stored.finish(logbook, begin, series=[stored.series("deployment_nominal", columns)])
    heading_, helm = axes_of("response", results)
    np.testing.assert_allclose(line(heading_, "nominal model")[:, 1], course)
    assert helm.get_ylabel() == "delta [deg]"
    assert np.max(helm.lines[0].get_ydata()) == pytest.approx(35.0)
    assert limits(helm) == pytest.approx([-35.0, 35.0])


def test_the_order_in_which_runs_ended_moves_no_point(tmp_path: Path) -> None:
    """Workers finish in any order; every seed keeps its place beside the bar."""

    def places(folder: str, seeds: list[int]) -> list[Any]:
        (tmp_path / folder).mkdir()
        with stored.logbook_at(tmp_path / folder) as logbook:
            for seed in seeds:
                begin = stored.start("ls", "noise", seed)
                stored.finish(logbook, begin, [stored.tracking(1.0 + seed**2)], drawn=["noise"])
        with open_results(f"{tmp_path}/{folder}/results.db") as results:
            (axes,) = axes_of("bars", results, metric="e_pos_mae")
            return [one.get_xydata() for one in axes.lines]

    orders = [*range(12)], [7, *range(7), *range(8, 12)]
    for one, other in zip(places("a", orders[0]), places("b", orders[1]), strict=True):
        np.testing.assert_array_equal(one, other)
