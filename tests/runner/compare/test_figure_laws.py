"""What holds of a figure whatever its data: one vessel, hulls to scale, limits at their value."""

from collections.abc import Callable
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from seatrial.models.diagnostics import Diagnostic
from seatrial.runner.compare.figures import drawings_of
from seatrial.runner.compare.frame import open_results
from seatrial.runner.compare.plots.request import PlotRequest
from seatrial.runner.compare.plots.style import Drawing, drawn
from seatrial.runner.compare.plots.track import LEAST_SHARE, drawn_length, outline
from seatrial.runner.database import LogbookWriter
from seatrial.runner.record.rows import Series
from tests.runner.compare import stored

Fill = Callable[[LogbookWriter], None]
T = np.arange(0.0, 100.0, 0.5)


@pytest.fixture
def draw(tmp_path: Path) -> Callable[..., list[Drawing]]:
    """Draw a kind of figure of a logbook that a function fills."""

    def call(kind: str, fill: Fill, **options: Any) -> list[Drawing]:
        with stored.logbook_at(tmp_path) as logbook:
            fill(logbook)
        with open_results(f"sqlite:///{tmp_path}/results.db") as results, drawn():
            drawings: list[Drawing] = drawings_of(kind)(results, PlotRequest(**options))
            for drawing in drawings:
                drawing.figure.draw_without_rendering()
        return drawings

    return call


def heading(figure: Figure) -> str:
    title = figure.legends[0].get_title() if figure.legends else figure._suptitle  # type: ignore[attr-defined]
    return " ".join(title.get_text().split())


@pytest.mark.parametrize(
    ("kind", "rows"), [("coefficients", "identifier"), ("coefficients", "vessel"), ("bars", None)]
)
def test_a_figure_has_one_vessel(
    draw: Callable[..., list[Drawing]], kind: str, rows: str | None
) -> None:
    """Also where no mean would mix them: each vessel has an identifier of its own."""

    def fill(logbook: LogbookWriter) -> None:
        for vessel, identifier in (("milliampere", "ls"), ("supply_vessel", "plsr")):
            run = stored.start(identifier, vessel=vessel)
            found = [stored.coefficient("u_dot", 1000.0, 5.0, 1000.0)]
            stored.finish(logbook, run, [stored.force_mse(4.0)], found)

    titles = [heading(one.figure) for one in draw(kind, fill, **({"rows": rows} if rows else {}))]
    assert ["milliampere" in title for title in titles] == [True, False]
    assert ["supply_vessel" in title for title in titles] == [False, True]


@pytest.mark.parametrize("polished", [False, True])
def test_a_front_shows_the_deployed_model_where_a_polish_has_moved_it(
    draw: Callable[..., list[Drawing]], polished: bool
) -> None:
    front = np.array([[1.0, 4.0], [2.0, 2.0], [4.0, 1.0]])
    deployed = np.array([1.5, 1.5]) if polished else front[1]

    def fill(logbook: LogbookWriter) -> None:
        rows = [
            Diagnostic("pareto_objective", "all", value, "m", i=i, j=j, label=f"error {j}")
            for (i, j), value in np.ndenumerate(front)
        ]
        rows.append(Diagnostic("pareto_chosen", "all", 1.0, i=1))
        rows += [Diagnostic("objective", "all", v, "m", j=j) for j, v in enumerate(deployed)]
        stored.finish(logbook, stored.start("nsga2"), diagnostics=rows)

    (drawing,) = draw("pareto", fill)
    rings = [
        (line.get_marker(), *np.ravel(line.get_xydata()))
        for line in drawing.figure.axes[0].lines
        if line.get_fillstyle() == "none"
    ]
    assert rings == [("o", 2.0, 2.0), *([("D", 1.5, 1.5)] if polished else [])]


def test_one_seed_has_no_whisker_and_no_whisker_reaches_the_floor(
    draw: Callable[..., list[Drawing]],
) -> None:
    def fill(logbook: LogbookWriter) -> None:
        stored.finish(logbook, stored.start("none"), [stored.force_mse(5000.0)])
        for seed, value in enumerate((1.0, 1.0, 100.0)):  # deviation above the mean
            stored.finish(logbook, stored.start("ls", seed=seed), [stored.force_mse(value)])

    (drawing,) = draw("bars", fill)
    (axes,) = drawing.figure.axes
    assert axes.get_yscale() == "log"
    (whisker,) = [s for lines in axes.collections for s in lines.get_segments()]
    deviation = np.std([1.0, 1.0, 100.0], ddof=1)
    np.testing.assert_allclose(whisker[:, 1], [34.0, 34.0 + deviation])


def test_the_residual_shown_is_of_median_improvement(draw: Callable[..., list[Drawing]]) -> None:
    """The newest run is the worst, and runs without identification are not considered."""
    ratios = {1: 0.2, 2: 0.5, 3: 0.4, 4: 0.9}

    def fill(logbook: LogbookWriter) -> None:
        for seed, ratio in ratios.items():
            metrics = [stored.force_mse(100.0, model="nominal"), stored.force_mse(100.0 * ratio)]
            stored.finish(logbook, stored.start("ls", seed=seed), metrics, (), (), [residual(1.0)])
        metrics = [stored.force_mse(100.0, model="nominal"), stored.force_mse(100.0)]
        stored.finish(logbook, stored.start("none"), metrics, (), (), [residual(1.0)])

    (drawing,) = draw("residual", fill)
    assert drawing.name == "residual-run-3"


def residual(size: float) -> Series:
    columns = {"t": T, "train": np.zeros_like(T)}
    columns |= {"residual_nominal_surge": 3.0 * size * np.sin(T)}
    columns |= {"residual_identified_surge": size * np.sin(T)}
    return Series("residual", columns, {"t": "s", "train": ""} | dict.fromkeys([*columns][2:], "N"))


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
    units = {"t": "s", "psi": "rad", "psi_d": "rad", "tau_surge": "N"}
    return Series(f"deployment_{model}", columns, dict.fromkeys(columns, "m") | units)


def sail(identified: float | None, limit: float = 2.5e5) -> Fill:
    def fill(logbook: LogbookWriter) -> None:
        vessel = {"length_m": 50.0, "dofs": ["surge"], "force_limits": [limit]}
        series = [voyage("nominal", 200.0)]
        series += [] if identified is None else [voyage("identified", identified)]
        stored.finish(logbook, stored.start(config={"vessel": vessel}), series=series)

    return fill


def notes_of(drawing: Drawing) -> str:
    return " ".join(drawing.figure._supxlabel.get_text().split())  # type: ignore[attr-defined]


@pytest.mark.parametrize("kind", ["track", "errors", "response"])
@pytest.mark.parametrize(
    ("identified", "said"), [(None, "did not sail"), (200.0, "sails the same track"), (190.0, "")]
)
def test_a_model_that_did_not_sail_is_not_one_that_sails_alike(
    draw: Callable[..., list[Drawing]], kind: str, identified: float | None, said: str
) -> None:
    (drawing,) = draw(kind, sail(identified))
    assert ("the identified model" in notes_of(drawing)) == bool(said)
    assert said in notes_of(drawing)


def test_a_controller_that_was_lost_is_named_beside_those_that_sailed(
    draw: Callable[..., list[Drawing]],
) -> None:
    def fill(logbook: LogbookWriter) -> None:
        for controller in ("lqi", "mpc_integral", "pid_ff"):
            begin = replace(stored.start(config={"by": controller}), controller=controller)
            if controller == "pid_ff":
                stored.fail(logbook, begin, "diverged")
            else:
                stored.finish(logbook, begin, series=[voyage("identified", 200.0)])

    (drawing,) = draw("response", fill, rows="controller")
    assert "not shown: pid_ff: diverged" in notes_of(drawing)


def test_bars_mark_lost_runs_and_unstable_designs_as_tables_do(
    draw: Callable[..., list[Drawing]],
) -> None:
    """Also on a logarithmic axis, and of a trial that was planned alone."""

    def fill(logbook: LogbookWriter) -> None:
        begins = [stored.start(name) for name in ("none", "ls", "plsr", "iv")]
        plan = stored.planned(begins)
        sweep = logbook.begin_sweep("night", "command", [], 4, trials=plan)
        for begin, value, radius in zip(begins, (1.0, 900.0), (0.9, 1.1), strict=False):
            metrics = [stored.tracking(value), stored.deployed("spectral_radius", radius)]
            stored.finish(logbook, begin, metrics, sweep=sweep)
        stored.fail(logbook, begins[2])

    (drawing,) = draw("bars", fill, metric="e_pos_mae", sweep="all")
    (axes,) = drawing.figure.axes
    assert axes.get_yscale() == "log"
    texts = {text.get_text(): text for text in axes.texts}
    assert texts.keys() == {"‡", "1 failed", "1 not started"}
    assert "‡ the controller is not stable" in notes_of(drawing)
    frame = axes.get_window_extent()
    assert all(frame.overlaps(text.get_window_extent()) for text in texts.values())


def test_forces_of_ships_are_in_kilonewtons_with_their_limits(
    draw: Callable[..., list[Drawing]],
) -> None:
    (drawing,) = draw("response", sail(201.0))
    _, force = drawing.figure.axes
    assert force.get_ylabel() == "Force, surge [kN]"
    line = next(line for line in force.lines if line.get_label() == "nominal model")
    assert np.max(line.get_ydata()) == pytest.approx(200.0, rel=1e-3)
    limits = [line.get_ydata()[0] for line in force.lines if line.get_label() == "limit"]
    assert limits == [-250.0, 250.0]


def test_inputs_of_a_steered_vessel_have_an_excitation(draw: Callable[..., list[Drawing]]) -> None:
    def fill(logbook: LogbookWriter) -> None:
        limit = float(np.radians(35.0))
        inputs = {"delta": {"low": -limit, "high": limit}, "n": {"low": 0.0, "high": 20.0}}
        delta = np.radians(20.0) * np.sign(np.sin(0.2 * T))
        columns = {"t": T, "delta": 0.9 * delta, "delta_command": delta, "n": 10.0 + 0.0 * T}
        series = Series("recording", columns, dict.fromkeys(columns, "") | {"t": "s"})
        begin = stored.start(config={"vessel": {"dofs": ["surge"], "inputs": inputs}})
        stored.finish(logbook, begin, series=[series])

    (drawing,) = draw("excitation", fill)
    helm, _ = drawing.figure.axes
    assert helm.get_ylabel() == "delta [deg]"
    assert helm.get_title(loc="left") == "peak 20.0 deg, 57% of the limit"
    lines = {str(line.get_label()): np.asarray(line.get_ydata()) for line in helm.lines}
    assert np.max(lines["commanded"]) == pytest.approx(20.0)
    assert np.max(lines["acting"]) == pytest.approx(18.0)
    limits = [line.get_ydata()[0] for line in helm.lines if line.get_label() == "limit"]
    assert limits == pytest.approx([-35.0, 35.0])
    assert "constant: n 10.0 1/s" in notes_of(drawing)


def test_a_steered_vessel_responds_with_heading_and_inputs(
    draw: Callable[..., list[Drawing]],
) -> None:
    def fill(logbook: LogbookWriter) -> None:
        limit = float(np.radians(35.0))
        psi = np.radians(170.0 + 40.0 * T / T[-1])  # across 180 degrees
        columns = {"t": T, "x": T, "y": T, "psi": np.angle(np.exp(1j * psi)), "psi_d": psi}
        columns |= {"delta": np.full_like(T, 0.5), "delta_command": np.full_like(T, limit)}
        units = {"t": "s", "psi": "rad", "psi_d": "rad", "x": "m", "y": "m"}
        series = Series("deployment_nominal", columns, dict.fromkeys(columns, "") | units)
        vessel = {"inputs": {"delta": {"low": -limit, "high": limit}}}
        stored.finish(logbook, stored.start(config={"vessel": vessel}), series=[series])

    (drawing,) = draw("response", fill)
    heading_, helm = drawing.figure.axes
    line = next(line for line in heading_.lines if line.get_label() == "nominal model")
    np.testing.assert_allclose(line.get_ydata(), 170.0 + 40.0 * T / T[-1])
    assert helm.get_ylabel() == "delta [deg]"
    assert np.max(helm.lines[0].get_ydata()) == pytest.approx(35.0)
    limits = [line.get_ydata()[0] for line in helm.lines if line.get_label() == "limit"]
    assert limits == pytest.approx([-35.0, 35.0])


def test_the_order_in_which_runs_ended_moves_no_point(tmp_path: Path) -> None:
    """Workers finish in any order; every seed keeps its place beside the bar."""

    def places(folder: str, seeds: list[int]) -> list[Any]:
        (tmp_path / folder).mkdir()
        with stored.logbook_at(tmp_path / folder) as logbook:
            for seed in seeds:
                begin = stored.start("ls", "noise", seed)
                stored.finish(logbook, begin, [stored.tracking(1.0 + seed**2)], drawn=["noise"])
        url = f"sqlite:///{tmp_path}/{folder}/results.db"
        with open_results(url) as results, drawn():
            (drawing,) = drawings_of("bars")(results, PlotRequest(metric="e_pos_mae"))
            return [line.get_xydata() for line in drawing.figure.axes[0].lines]

    orders = [*range(12)], [7, *range(7), *range(8, 12)]
    for one, other in zip(places("a", orders[0]), places("b", orders[1]), strict=True):
        np.testing.assert_array_equal(one, other)
