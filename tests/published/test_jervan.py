"""Jervan (2020) from the configuration to the stored rows; prototype figures from the errata."""

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from runner.database.records import Results
from runner.rebuild import vessel_of

DOFS = ("surge", "sway", "yaw")
Run = Callable[..., Results]
Values = Callable[..., dict[str, float]]


def printed(row: str) -> dict[str, float]:
    """The residual MSE that the thesis prints for a model, by degree of freedom."""
    with (Path(__file__).parent / "jervan_residual_mse.csv").open() as file:
        found = next(line for line in csv.DictReader(file) if line["row"] == row)
    return {dof: float(found[dof]) for dof in DOFS}


def test_the_nominal_residual_is_the_printed_one(run: Run, metric: Values) -> None:
    mse = metric(run("identifier=none"), "force_mse", "nominal")
    for dof, value in printed("without PLSR model").items():
        assert mse[dof] == pytest.approx(value, rel=0.15)
    prototype = {"surge": 2919.0, "sway": 4346.0, "yaw": 7617.0}
    for dof, value in prototype.items():
        assert mse[dof] == pytest.approx(value, rel=1e-3)


def test_no_identifier_leaves_the_model_as_it_was(run: Run, metric: Values) -> None:
    results = run("identifier=none")
    for name in ("force_mse", "e_pos_mae", "tau_mean_abs"):
        assert metric(results, name, "nominal") == metric(results, name, "identified")


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


def test_plsr_beats_the_printed_residual_on_the_commanded_force(run: Run, metric: Values) -> None:
    results = run("identifier=plsr", "identifier.force=commanded", "identifier.selection=test")
    mse = metric(results, "force_mse")
    for dof, value in printed("with regular PLSR model").items():
        assert mse[dof] <= value
    assert metric(results, "e_pos_mae")["position"] <= 0.086  # Table 4.10
    assert metric(results, "e_pos_mae", "nominal")["position"] == pytest.approx(0.24, abs=0.01)


def test_a_fit_of_the_lag_is_flagged(run: Run, metric: Values) -> None:
    thesis = run("identifier=plsr", "identifier.force=commanded", "identifier.selection=test")
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
            "disturbance=noise", "evaluation=none", f"seed={seed}",
        )  # fmt: skip
        rows = [row for row in results.coefficients if row.model == "identified"]
        model = vessel_of(rows, "identified")
        errors.append(np.diag(model.inertia) / [1194.8285, 1266.9555, 2534.455] - 1.0)
    assert np.all(np.abs(np.mean(errors, axis=0)) <= 0.02)


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
    results = run("identifier=ls", "controller.feedback=false", "evaluation=replay")
    for name in ("nu_mse", "nu_dot_mse"):
        nominal, identified = metric(results, name, "nominal"), metric(results, name)
        assert nominal["surge"] > 2.0 * identified["surge"]


def test_a_crossing_by_line_of_sight_improves_too(run: Run, metric: Values) -> None:
    results = run("identifier=ls", "evaluation=operation")
    errors = {m: metric(results, "e_pos_mae", m)["position"] for m in ("nominal", "identified")}
    assert errors["identified"] < 0.5 * errors["nominal"]
    series = next(s for s in results.series if s.kind == "deployment_identified")
    assert np.hypot(series.columns["x"][-1] - 110.0, series.columns["y"][-1] - 25.0) < 0.5


def test_the_experiment_is_the_same_trial(run: Run, metric: Values) -> None:
    found = metric(run("experiment=jervan_table_4_5"), "force_mse")
    for dof, value in printed("with regular PLSR model").items():
        assert found[dof] <= value
    byhand = run("identifier=plsr", "identifier.force=commanded", "identifier.selection=test")
    assert found == metric(byhand, "force_mse")
