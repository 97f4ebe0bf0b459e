"""Jervan (2020) from the configuration to the stored rows; prototype figures from the errata."""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from docs.published.figures import force_error_figure, iaew_figure, scaled_coefficients_figure
from docs.published.printed import read_folder
from seatrial.runner.compare.frame import Queries, open_results
from seatrial.runner.record.coefficient_rows import vessel_of
from seatrial.runner.record.rows import Results
from tests.published.conftest import Run, Values, store

THESIS = (
    "identifier=plsr", "identifier.force=commanded", "identifier.selection=test",
    "identifier.lowpass_hz=null", "identifier.inertia_factor=null", "deploy_unphysical=true",
)  # fmt: skip


def printed(experiment: str, row: str) -> dict[str, float]:
    """The residual MSE that the thesis prints for a model, by degree of freedom."""
    figures = read_folder(experiment=experiment)[experiment]
    chosen = [one for one in figures if one.row == row and one.name == "force_mse"]
    return {one.dof: one.printed for one in chosen if one.printed is not None}


REGULAR = ("jervan_table_4_5", "with regular PLSR model")


def test_the_nominal_residual_is_the_printed_one(run: Run, metric: Values) -> None:
    mse = metric(run("identifier=none"), "force_mse", "nominal")
    for dof, value in printed("jervan_table_4_2", "without PLSR model").items():
        assert mse[dof] == pytest.approx(value, rel=0.15)
    prototype = {"surge": 2919.0, "sway": 4346.0, "yaw": 7617.0}
    for dof, value in prototype.items():
        assert mse[dof] == pytest.approx(value, rel=1e-3)


def test_filtered_force_makes_least_squares_exact(run: Run) -> None:
    results = run("identifier=ls", "identifier.force=filtered")
    rows = [row for row in results.coefficients if row.model == "residual" and row.true_value]
    assert len(rows) == 26  # every coefficient of F0 that is not zero
    nominal = {(r.term, r.dof): r.value for r in results.coefficients if r.model == "nominal"}
    for row in rows:
        assert row.true_value == pytest.approx(-0.5 * nominal[row.term, row.dof])
        assert row.value == pytest.approx(row.true_value, rel=1e-3)
    others = [row for row in results.coefficients if row.model == "residual" and not row.true_value]
    assert len(others) == 31 * 3 - 26
    assert max(abs(row.value) for row in others) < 1e-3


def test_the_printed_true_model_is_wrong_in_the_cross_terms_alone(run: Run) -> None:
    """Table 4.11: the cross terms are not halved, most with the sign of the derivative."""
    results = run("identifier=ls", "identifier.force=filtered")
    truth = {(r.dof, r.term): r.true_value for r in results.coefficients if r.model == "residual"}
    figures = read_folder(experiment="jervan_table_4_11")["jervan_table_4_11"]
    claimed = [one for one in figures if one.row == "true model of the residual"]
    assert {(one.dof, one.name) for one in claimed} == {k for k, v in truth.items() if v}
    cross = {"r^2", "uv", "ur", "vr", "|v|r", "|r|v"}
    for one in claimed:
        value = truth[one.dof, one.name]
        assert one.printed is not None
        assert value is not None
        halves = 0.5 if one.name == "|r|v" else -0.5
        factor = halves if one.name in cross else 1.0
        assert value == pytest.approx(factor * one.printed, abs=0.006), one.quantity


def test_with_a_lead_the_lap_is_tracked_within_a_centimetre(run: Run, metric: Values) -> None:
    """Table 4.10 prints 0.086 m."""
    led = run("identifier=ls", "identifier.force=filtered", "controller.thruster_lead=true")
    assert metric(led, "e_pos_mae")["position"] <= 0.01


def test_plsr_beats_the_printed_residual_on_the_commanded_force(run: Run, metric: Values) -> None:
    results = run(*THESIS)
    mse = metric(results, "force_mse")
    for dof, value in printed(*REGULAR).items():
        assert mse[dof] <= value
    assert metric(results, "e_pos_mae")["position"] <= 0.086  # Table 4.10
    assert metric(results, "e_pos_mae", "nominal")["position"] == pytest.approx(0.24, abs=0.01)


def test_a_fit_of_the_lag_is_flagged(run: Run, metric: Values) -> None:
    thesis = run(*THESIS)
    assert metric(thesis, "below_true_model")["yaw"] == 1.0
    assert metric(thesis, "force_mse")["yaw"] < 0.99 * metric(thesis, "force_mse", "plant")["yaw"]
    exact = run("identifier=ls", "identifier.force=filtered")
    assert set(metric(exact, "below_true_model").values()) == {0.0}


@pytest.mark.slow
@pytest.mark.nightly
def test_diagonal_inertia_under_noise(run: Run) -> None:
    errors = []
    for seed in range(20):
        results = run(
            "identifier=ls", "identifier.force=filtered", "identifier.lowpass_hz=0.5",
            "identifier.basis=physical", "disturbance=noise", "evaluation=none", f"seed={seed}",
        )  # fmt: skip
        rows = [row for row in results.coefficients if row.model == "identified"]
        model = vessel_of(rows, "identified")
        errors.append(np.diag(model.inertia) / [1194.8285, 1266.9555, 2534.455] - 1.0)
    assert np.all(np.abs(np.mean(errors, axis=0)) <= 0.01)
    assert np.max(np.abs(errors)) <= 0.02  # of every seed


def test_a_constant_force_is_identified_through_the_heading(run: Run) -> None:
    results = run(
        "identifier=ls", "disturbance=constant", 'identifier.extra_terms=["cos(psi)","sin(psi)"]'
    )
    values = {
        (r.dof, r.term): (r.value, r.true_value)
        for r in results.coefficients
        if r.model == "residual"
    }
    assert values["surge", "cos(psi)"][0] == pytest.approx(-200.0, abs=1e-6)
    assert values["surge", "sin(psi)"][0] == pytest.approx(-100.0, abs=1e-6)
    assert values["sway", "cos(psi)"][0] == pytest.approx(-100.0, abs=1e-6)
    assert values["sway", "sin(psi)"][1] == 200.0


def test_without_feedback_the_reference_velocity_is_compared(run: Run, metric: Values) -> None:
    """Table 4.8: the deployment has no feedback, the data have."""
    results = run("identifier=ls", "controller.deployed_feedback=false", "evaluation=replay")
    for name in ("nu_mse", "nu_dot_mse"):
        nominal, identified = metric(results, name, "nominal"), metric(results, name)
        for dof, value in nominal.items():
            assert value > 2.0 * identified[dof]
    assert set(metric(results, "tau_fb_mean_abs").values()) == {0.0}


def test_a_crossing_by_line_of_sight_improves_too(run: Run, metric: Values) -> None:
    results = run("identifier=ls", "evaluation=operation")
    errors = {m: metric(results, "e_pos_mae", m)["position"] for m in ("nominal", "identified")}
    assert errors["identified"] < 0.5 * errors["nominal"]
    series = next(s for s in results.series if s.kind == "deployment_identified")
    assert np.hypot(series.columns["x"][-1] - 110.0, series.columns["y"][-1] - 25.0) < 0.5


def test_the_experiment_is_the_same_trial(run: Run, metric: Values) -> None:
    found = metric(run("experiment=jervan_table_4_5", "identifier.selection=test"), "force_mse")
    assert found == metric(run(*THESIS), "force_mse")


def drawn(
    folder: Path, draw: Callable[[Queries, int], Figure], results: Results,
    identifier: str, options: Mapping[str, object],
) -> list[Axes]:  # fmt: skip
    """The panels of a figure of the published page, of one stored run."""
    sweep = store(folder, results, identifier=identifier, config=options)
    with open_results(f"sqlite:///{folder}/results.db") as queries:
        return draw(queries, sweep).axes


def scaled(results: Results, dof: str) -> dict[str, float]:
    """|Theta_pre| by term, the most influential first."""
    found = [d for d in results.diagnostics if (d.name, d.dof) == ("scaled_coefficient", dof)]
    sizes = {d.label: abs(d.value) for d in found if d.label is not None and d.value is not None}
    return dict(sorted(sizes.items(), key=lambda each: -each[1]))


def test_the_terms_that_matter_in_the_case_model(run: Run, tmp_path: Path) -> None:
    """Figure 4.6: surge by u_dot and u, sway also by r, yaw by r_dot, r and a little by v."""
    results = run("experiment=jervan_table_4_2", "identifier.selection=test")
    most = {dof: list(scaled(results, dof))[:3] for dof in ("surge", "sway", "yaw")}
    assert most["surge"][:2] == ["u_dot", "u"]
    assert most["sway"] == ["v_dot", "v", "r"]
    assert most["yaw"] == ["r_dot", "r", "v"]
    options = {"identifier": {"selection": "test"}}
    axes = drawn(tmp_path, scaled_coefficients_figure, results, "plsr", options)
    assert [panel.get_title("left").split(",")[0] for panel in axes] == ["surge", "sway", "yaw"]
    for panel in axes:
        names = [tick.get_text() for tick in panel.get_xticklabels()]
        heights = [bar.get_height() for bar in panel.patches]
        expected = scaled(results, panel.get_title("left").split(",")[0])
        assert dict(zip(names, heights, strict=True)) == pytest.approx(expected, rel=1e-12)


def test_the_terms_that_look_alike_and_high_powers(run: Run) -> None:
    """Figures 4.14, 4.16 and 4.18."""
    experiment = "experiment=jervan_figure_4_14"
    alike = run(experiment, "identifier.basis=[u,v,r,'|u|','|v|','|r|']")
    surge, sway = scaled(alike, "surge"), scaled(alike, "sway")
    assert surge["u"] == pytest.approx(surge["|u|"], rel=0.05)  # it hardly moves backwards
    assert sway["|v|"] < 0.1 * sway["v"]
    powers = ",".join(f"'{dof}^{n}'" for n in range(2, 7) for dof in "uvr")
    for identifier, low, high in (("plsr_unit_variance", 0.9, 2.0), ("plsr", 0.0, 0.35)):
        results = run(experiment, f"identifier={identifier}", f"identifier.basis=[u,v,r,{powers}]")
        found = scaled(results, "surge")
        assert low < found["u^6"] / found["u"] < high


def test_the_iaew_over_time_ends_at_the_metric(run: Run, metric: Values, tmp_path: Path) -> None:
    """Figures 4.38 and 4.39; the curves never fall."""
    results = run("experiment=jervan_table_4_12", "identifier=ls", "identifier.force=filtered")
    options = {
        "identifier": {"force": "filtered"}, "controller": {"thruster_lead": False},
    }  # fmt: skip
    panels = drawn(tmp_path, iaew_figure, results, "ls", options)
    for panel, dof in zip(panels, ("position", "heading"), strict=True):
        size = 1e6 if "MJ" in panel.get_ylabel() else 1e3 if "kJ" in panel.get_ylabel() else 1.0
        for line, model in zip(panel.lines, ("nominal", "identified"), strict=True):
            curve = size * np.asarray(line.get_ydata())
            assert curve[-1] == pytest.approx(metric(results, "iaew", model)[dof], rel=1e-9)
            assert np.all(np.diff(curve) >= 0.0)


def test_the_error_is_about_as_large_as_an_unknown_force(run: Run, tmp_path: Path) -> None:
    """Figure 4.47: "the mean of the error matches closely to the magnitude of the disturbance"."""
    results = run(
        "experiment=jervan_table_4_16", "identifier=plsr", "identifier.force=commanded",
        "identifier.selection=test", "identifier.bootstrap=null",
    )  # fmt: skip
    (panel,) = drawn(tmp_path, force_error_figure, results, "plsr", {})
    lines = {line.get_label(): np.asarray(line.get_ydata(), dtype=float) for line in panel.lines}
    np.testing.assert_allclose(lines["|force|"], np.hypot(200.0, 100.0), rtol=1e-12)
    assert np.mean(lines["|error|"]) == pytest.approx(np.hypot(200.0, 100.0), rel=0.15)
    np.testing.assert_allclose(lines["mean of |error|"], np.mean(lines["|error|"]), rtol=1e-12)
