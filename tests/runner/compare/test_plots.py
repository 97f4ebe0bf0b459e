"""Figures: files of both kinds, the same every time, with the numbers of the logbook."""

import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.quiver import Quiver

from seatrial.models.errors import ConfigurationError, LogbookError
from seatrial.runner.compare.figures import PlotRequest, figures
from seatrial.runner.compare.frame import Queries, open_results
from seatrial.runner.compare.plots import draw, figures_of
from seatrial.runner.compare.plots.style import width_of
from seatrial.runner.database import LogbookWriter
from tests.runner.compare import stored
from tests.runner.compare.drawing import axes_of, drawings, limits, line, notes

VOYAGES = "disturbance=constant"  # the runs that deployed what they identified


@pytest.fixture
def voyages(sailed: Path) -> Iterator[Queries]:
    with open_results(f"sqlite:///{sailed}/results.db") as opened:
        yield opened


@pytest.mark.slow
@pytest.mark.parametrize("kind", figures())
def test_every_kind_writes_its_files(sailed: Path, ranked: Path, tmp_path: Path, kind: str) -> None:
    """PNG and SVG, and a PDF as wide as the paper's column, with TrueType fonts; without a date."""
    folder = ranked if kind == "critical_difference" else sailed
    with open_results(f"{folder}/results.db") as results:
        png, svg = draw(results, PlotRequest(kind), tmp_path / "a" / "b")
        (path,) = draw(results, PlotRequest(kind, width="column"), tmp_path)
    assert png.read_bytes().startswith(b"\x89PNG")
    assert b"<dc:date>" not in svg.read_bytes()
    content = path.read_bytes()
    box = re.search(rb"/MediaBox \[ 0 0 (\S+) (\S+) \]", content)
    assert box is not None
    assert float(box[1]) == pytest.approx(width_of("column") * 72.0 / 25.4, abs=0.01)
    assert b"/FontFile2" in content
    assert b"/Type3" not in content
    assert b"CreationDate" not in content


@pytest.mark.slow
def test_a_figure_is_drawn_the_same_twice(voyages: Queries, tmp_path: Path) -> None:
    """To the byte, so that a committed figure changes with its data alone."""
    for kind in ("track", "bars"):
        first, second = (draw(voyages, PlotRequest(kind), tmp_path / name) for name in "ab")
        assert [path.read_bytes() for path in first] == [path.read_bytes() for path in second]


def test_drawing_leaves_the_settings_of_matplotlib_alone(voyages: Queries, tmp_path: Path) -> None:
    before = dict(mpl.rcParams)
    draw(voyages, PlotRequest("bars"), tmp_path)
    assert dict(mpl.rcParams) == before


def test_bars_are_means_with_deviations_and_points_are_seeds(results: Queries) -> None:
    surge, yaw = axes_of("bars", results)
    assert surge.get_ylabel() == "Force MSE, surge [N²]"
    assert yaw.get_ylabel() == "Force MSE, yaw [(Nm)²]"
    heights = [bar.get_height() for bar in surge.patches]
    assert heights[0] == 102.0  # none, calm
    assert heights[2:4] == [52.0, 90.0]  # ls, calm and noise
    texts = [text.get_text() for text in surge.texts]
    assert "1 diverged\n1 failed" in texts
    assert "†" in texts
    assert "1 no value" in texts
    points = np.concatenate([one.get_ydata() for one in surge.lines if len(one.get_xdata()) == 3])
    assert {50.0, 51.0, 55.0} <= set(points.tolist())


def test_orders_mark_what_was_selected(voyages: Queries) -> None:
    surge, yaw = axes_of("orders", voyages)
    curve, *markers = surge.lines
    assert curve.get_ydata()[0] == pytest.approx(3000.0 + 90.0 + 0.5)  # median of two seeds
    assert [marker.get_xdata()[0] for marker in markers] == [4, 5]
    assert yaw.get_ylabel() == "Force MSE, yaw [(Nm)²]"


def test_residual_says_the_error_of_the_held_out_part(voyages: Queries) -> None:
    surge, _ = axes_of("residual", voyages, run=1)
    t = np.arange(50.0, 100.0, 0.5)
    rms = 60.0 * np.sqrt(np.mean(np.sin(t / 5.0) ** 2))
    assert surge.texts[0].get_text() == f"rms {rms:.1f} N"


def test_track_is_north_up_with_equal_axes(voyages: Queries) -> None:
    nominal, identified = axes_of("track", voyages, run=1)
    assert nominal.get_xlabel() == "East [m]"
    assert nominal.get_ylabel() == "North [m]"
    assert nominal.get_aspect() == 1.0
    east, north = line(nominal, "nominal model").T
    assert (east.max(), north.max()) == pytest.approx((60.5, 20.5))
    assert nominal.get_xlim() == identified.get_xlim()
    # where the heading is north the bow is the northernmost corner of the hull
    hull = nominal.patches[-1].get_path().vertices
    assert len(nominal.patches) == 24
    bow, stern = hull[0], 0.5 * (hull[2] + hull[3])
    psi = np.arctan2(bow[0] - stern[0], bow[1] - stern[1])
    assert psi == pytest.approx(2.0 * np.pi * 199.5 / 200.0 - 2.0 * np.pi, abs=1e-6)


def test_wind_arrows_point_where_it_blows_to_with_their_tips_at_the_vessel(
    voyages: Queries,
) -> None:
    axes, _ = axes_of("track", voyages, run=1)
    (arrows,) = [one for one in axes.collections if isinstance(one, Quiver)]
    assert arrows.pivot == "tip"
    eastward, southward = arrows.U > 0.0, arrows.V < 0.0
    assert np.all(eastward ^ southward)
    np.testing.assert_allclose(arrows.U[eastward], 4.0)
    np.testing.assert_allclose(arrows.V[southward], -8.0)
    radius = np.hypot(arrows.Y / 20.5, (arrows.X - 30.0) / 30.5)
    np.testing.assert_allclose(radius, 1.0, atol=0.01)  # on the track
    assert "wind, up to 8.00 m/s" in [one.get_label() for one in axes.lines]


@pytest.fixture
def recorded(logbook: LogbookWriter, results: Queries) -> Queries:
    """A run with a recording alone."""
    stored.finish(logbook, stored.start("none"), series=[stored._recording()])
    return results


def test_an_excitation_without_a_deployment_has_a_track_too(recorded: Queries) -> None:
    (axes,) = axes_of("track", recorded)
    east, north = line(axes, "sailed").T
    assert (north[-1], np.ptp(east)) == (199.5, 0.0)  # due north


def test_wind_of_a_recording_has_speed_direction_and_force(recorded: Queries) -> None:
    *_, speed, direction, force, moment = axes_of("excitation", recorded)
    np.testing.assert_allclose(speed.lines[0].get_ydata(), 10.0)
    blown = direction.lines[0].get_ydata()
    assert np.mean(blown) == pytest.approx(350.0, abs=1.0)
    assert np.max(blown) > 360.0  # no jump to 0
    assert [panel.get_ylabel() for panel in (force, moment)] == [
        "Wind force [N]",
        "Wind moment [Nm]",
    ]
    assert "wind, surge" in [one.get_label() for one in force.lines]
    np.testing.assert_array_equal(moment.lines[0].get_ydata(), -4.0)
    assert moment.texts[0].get_text() == "-4.00 Nm"
    *_, only = axes_of("excitation", recorded, dof=["yaw"])
    assert only.get_ylabel() == "Wind moment [Nm]"


def test_singular_values_are_filled_within_the_order(voyages: Queries) -> None:
    *_, singular = axes_of("excitation", voyages, where="identifier=dsr")
    every, filled = singular.lines
    assert [len(every.get_xdata()), len(filled.get_xdata())] == [8, 3]
    assert every.get_ydata()[0] == pytest.approx(np.exp(-1.0))


def test_an_excitation_stands_against_the_limits_with_its_spectrum(voyages: Queries) -> None:
    surge, spectrum, yaw, *_ = axes_of("excitation", voyages, run=1)
    assert surge.get_title(loc="left") == "peak 90.0 N, 90% of the limit"
    assert limits(surge) == [-100.0, 100.0]
    assert limits(yaw) == []  # far away
    frequency, size = spectrum.lines[0].get_data()
    assert frequency[np.argmax(size)] == pytest.approx(1.0 / 20.0)
    assert np.max(size) == pytest.approx(90.0)
    assert spectrum.get_title(loc="left") == "spectral lines: 1; 2 of 3 terms separable"
    assert "surge, not separable: u ~ |u|u" in notes(surge.figure)
    assert "no force in sway" in notes(surge.figure)


def test_figures_over_time_take_the_newest_run_of_each_level(voyages: Queries) -> None:
    for kind in ("track", "excitation"):
        names = [one.name for one in drawings(kind, voyages, facet="seed", where=VOYAGES)]
        assert names == [f"{kind}-run-2", f"{kind}-run-4"]
        (one,) = drawings(kind, voyages, facet="identifier", where="seed=0 and identifier=ls")
        assert one.name == f"{kind}-run-1"


def test_errors_are_in_metres_and_degrees(voyages: Queries) -> None:
    position, heading = axes_of("errors", voyages, run=1)
    assert position.get_ylabel() == "Position error [m]"
    assert [text.get_text() for text in position.texts] == ["MAE 0.500 m", "MAE 0.100 m"]
    assert line(heading, "nominal model")[0, 1] == pytest.approx(np.degrees(0.05))


def test_coefficients_are_relative_to_the_truth_with_their_intervals(voyages: Queries) -> None:
    surge, sway = axes_of("coefficients", voyages, where="identifier=ls", run=1)
    ticks = [label.get_text() for label in surge.get_yticklabels()]
    assert ticks == ["u_dot: 1195 kg", "u: 13.80 kg/s", "|u|u: 55.00 kg/m"]  # u^3 is truly zero
    assert sway.get_xlabel() == "relative to the estimate"
    assert {one.get_label() for one in surge.lines if one.get_marker() == "o"} == {"ls"}
    spans = [one.get_xdata() for one in surge.lines if one.get_linestyle() == "--"]
    low, high = spans[1]
    assert 0.5 * (low + high) == pytest.approx(15.0 / 13.8)
    assert (high - low) / 2.0 == pytest.approx(1.959964 * 3.0 / 13.8, rel=1e-6)
    assert any("→" in text.get_text() for text in surge.texts)  # 9000 of 55 is off the axis


def test_an_interval_that_does_not_cover_is_not_drawn_as_one_that_does(
    logbook: LogbookWriter, results: Queries
) -> None:
    found = [stored.coefficient("u_dot", 1000.0, 30.0, 1195.0)]
    for identifier, of_estimate in (("iv", False), ("ridge", True)):
        diagnostics = [stored.interval(of_estimate)]
        stored.finish(logbook, stored.start(identifier), (), found, diagnostics)
    for identifier, style, legend in (
        ("iv", "-", "95 % interval"), ("ridge", "--", "95 % interval, without bias"),
    ):  # fmt: skip
        (axes,) = axes_of("coefficients", results, where=f"identifier={identifier}")
        spans = [one for one in axes.lines if len(one.get_xdata()) == 2]
        (interval,) = [one for one in spans if np.ptp([*one.get_xdata(), 1.0]) > 0.02]
        assert interval.get_linestyle() == style
        _, labels = axes.get_legend_handles_labels()
        assert [label for label in labels if "95 %" in label] == [legend]


def test_a_damaged_series_file_is_named(sailed: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(sailed, copy)
    file = next((copy / "series").glob("run-000004-*"))
    file.write_bytes(file.read_bytes()[:-1] + b"x")
    with (
        open_results(f"sqlite:///{copy}/results.db") as damaged,
        pytest.raises(LogbookError, match="run-000004"),
    ):
        drawings("residual", damaged)


def test_a_folder_that_cannot_be_written_is_one_line(voyages: Queries, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(LogbookError, match="cannot write the figure"):
        draw(voyages, PlotRequest("bars"), tmp_path / "file" / "figures")


def test_the_track_of_a_mix_shows_its_plan_and_what_is_in_the_way(voyages: Queries) -> None:
    (axes,) = axes_of("track", voyages, where="identifier=iv")
    _, labels = axes.get_legend_handles_labels()
    assert sorted(labels) == ["goal", "multisine", "passage", "sailed", "start", "zigzag_10"]
    width = {one.get_label(): one.get_linewidth() for one in axes.lines}
    assert width["multisine"] < width["zigzag_10"]  # held out for testing
    corners = [patch.get_xy() for patch in axes.patches if hasattr(patch, "get_xy")]
    assert [len(one) for one in corners] == [5, 4, 4]  # closed: the area and two obstacles
    assert axes.get_aspect() == 1.0
    np.testing.assert_allclose(line(axes, "start"), [[5.0, 5.0]])  # east, north
    assert "deviated from the plan by at most 0.25 m" in notes(axes.figure)


def test_bands_are_drawn_about_poses_and_velocities_at_their_level(voyages: Queries) -> None:
    """Half the width at 90 % over that at 50 % is that of a normal distribution."""
    widths = {}
    for band in (50.0, 90.0):
        axes = axes_of("prediction", voyages, dof=["surge"], band=band)
        assert [panel.get_ylabel() for panel in axes] == ["X [m]", "Surge [m/s]"]
        for k, panel in enumerate(axes):
            (drawn_band,) = panel.collections
            path = drawn_band.get_paths()[0].vertices
            widths[band, k] = np.ptp(path[np.isclose(path[:, 0], np.max(path[:, 0])), 1])
    for k in range(2):
        assert widths[90.0, k] / widths[50.0, k] == pytest.approx(1.6449 / 0.6745, rel=1e-3)
    with pytest.raises(ConfigurationError, match="--band: got 100, expected"):
        axes_of("prediction", voyages, band=100.0)


def test_a_run_without_a_distribution_has_no_bands(
    logbook: LogbookWriter, results: Queries
) -> None:
    t = np.arange(0.0, 10.0)
    columns = {"t": t, "start": 1.0 * (t == 0.0), "surge": t, "surge_identified": t}
    series = [stored.series("prediction", columns)]
    stored.finish(logbook, stored.start("none", "calm"), series=series)
    with pytest.raises(ConfigurationError, match="has no bands"):
        axes_of("prediction", results, band=90.0)


def test_one_panel_is_drawn_into_the_axes_of_the_caller(results: Queries) -> None:
    sheet = Figure()
    left, right = sheet.subplots(1, 2)
    right.set_title("mine")
    request = PlotRequest("bars", dof=["surge"], where="disturbance=calm")
    (own,) = figures_of(results, request)
    assert figures_of(results, request, left) == [sheet]
    heights = [bar.get_height() for bar in own.axes[0].patches]
    assert heights == [pytest.approx(mean) for mean in (102.0, 52.0, 41.0)]  # of `plain`
    assert [bar.get_height() for bar in left.patches] == heights
    assert (right.get_title(), len(right.patches), sheet.legends) == ("mine", 0, [])
    assert sheet.axes == [left, right]
    sheet.draw_without_rendering()


def test_axes_cannot_hold_several_panels_or_figures(results: Queries, voyages: Queries) -> None:
    axes = Figure().subplots()
    with pytest.raises(ConfigurationError, match="ax: got axes for a figure of several panels"):
        figures_of(voyages, PlotRequest("errors"), axes)
    with pytest.raises(ConfigurationError, match="got axes for one of 3 figures"):
        figures_of(results, PlotRequest("bars", dof=["surge"], facet="identifier"), axes)
    figures_of(voyages, PlotRequest("bars", dof=["surge"]))  # the axes are forgotten


def test_a_width_that_is_none_is_refused() -> None:
    for text in ("colum", "-5", "0", "5", "1e9", "nan", "inf", ""):
        with pytest.raises(ConfigurationError, match=r"--width: got .* expected column, page or"):
            width_of(text)
