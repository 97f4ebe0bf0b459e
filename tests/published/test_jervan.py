"""Jervan (2020) from the configuration to the stored rows; prototype figures from the errata."""

from collections.abc import Callable

import numpy as np
import pytest

from docs.published.printed import read_folder
from seatrial.runner.record.coefficient_rows import vessel_of
from seatrial.runner.record.rows import Results

Run = Callable[..., Results]
Values = Callable[..., dict[str, float]]


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


def test_without_feedback_the_reference_velocity_is_still_compared(
    run: Run, metric: Values
) -> None:
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
    for dof, value in printed(*REGULAR).items():
        assert found[dof] <= value
    byhand = run(*THESIS)
    assert found == metric(byhand, "force_mse")
