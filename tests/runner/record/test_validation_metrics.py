"""Rows of errors and predictions on the held-out part."""

from dataclasses import replace

import numpy as np
import pytest

from seatrial.models.identification.problem import Problem
from seatrial.models.recording.recording import Recording
from seatrial.models.vessel.basis import terms
from seatrial.models.vessel.table import Vessel
from seatrial.runner.trials import trial as trials
from seatrial.runner.trials.validation_metrics import predictions, residuals
from tests.models.identification.conftest import driven, surge
from tests.trials import asked_for


def test_a_model_that_cannot_be_simulated_has_every_row_without_a_value() -> None:
    nominal = surge(60.0, 20.0)
    recording = driven(nominal, 10.0 * np.sin(0.1 * np.arange(300)))
    problem = Problem(recording, recording, nominal, None)
    impossible = replace(nominal, theta=-nominal.theta)
    predicted = predictions(problem, {"nominal": nominal, "identified": impossible})
    rows, reasons = predicted.metrics, predicted.diagnostics
    named = {
        model: {(row.name, row.dof): row.value for row in rows if row.model == model}
        for model in ("nominal", "identified")
    }
    assert set(named["identified"]) == set(named["nominal"])
    known = {name: v for (name, _), v in named["identified"].items() if v and np.isfinite(v)}
    horizons = ("one_step", "ten_step", "restarts", "free_run")
    assert known == {f"limited_share_{name}": 1.0 for name in horizons}
    assert named["identified"]["held_free_run", "all"] == 0.0
    assert [reason.name for reason in reasons] == ["no_prediction"]
    (series,) = predicted.series
    assert {"surge_nominal", "surge_identified"} & set(series.columns) == {"surge_nominal"}


def test_the_median_error_is_over_the_vessels_own_terms() -> None:
    still = np.zeros((3, 1))
    recording = Recording(
        ("surge",), np.arange(3.0), still, still, still, still, np.zeros((3, 3)),
        wind=np.zeros((3, 2)),
    )  # fmt: skip

    def vessel(values: dict[str, float]) -> Vessel:
        return Vessel("test", ("surge",), terms(values), np.array([list(values.values())]).T)

    nominal = vessel({"u_dot": 100.0, "u": 10.0, "|u|u": 5.0})
    truth = vessel({"u_dot": 100.0, "u": 20.0, "|u|u": 4.0, "|u_q|u_q": 7.0})
    models = {"nominal": nominal, "identified": truth, "plant": truth}
    found = residuals(recording, models)
    errors = {row.model: row.value for row in found if row.name == "coefficient_error_median"}
    # errors 0, 0.5 and 0.25; that of the wind's term, 1, is not counted
    assert errors == {"nominal": pytest.approx(0.25), "identified": 0.0}


def test_a_free_run_ends_where_it_diverges_and_begins_again_after_a_gap() -> None:
    nominal = surge(60.0, 20.0)
    recording = driven(nominal, 10.0 * np.sin(0.1 * np.arange(300)), "rk4")
    late = replace(recording, t=recording.t + 100.0 * (np.arange(300) >= 200))
    unstable = replace(nominal, theta=nominal.theta * [[1.0], [-20.0]])
    problem = Problem(late, late, nominal, None)
    predicted = predictions(problem, {"nominal": nominal, "identified": unstable})
    columns = predicted.series[0].columns
    run = columns["surge_identified"]
    np.testing.assert_allclose(columns["surge_nominal"], late.nu[:, 0], atol=1e-6)
    lost = np.isnan(run)
    first, second = np.flatnonzero(lost[:200])[0], 200 + np.flatnonzero(lost[200:])[0]
    assert np.all(lost[first:200])
    assert np.all(lost[second:])
    again = [columns["x_identified"][200], run[200]]
    assert np.array_equal(again, [late.eta[200, 0], late.nu[200, 0]])
    held = {row.model: row.value for row in predicted.metrics if row.name == "held_free_run"}
    assert held["identified"] == pytest.approx(late.period_s * (first - 1))


def test_the_band_of_a_prediction_is_stored_and_holds_the_model_error_if_asked_for() -> None:
    """Without it, it is what the data leave open of the parameters alone."""
    options = (
        "vessel=surge_nonlinear", "excitation=multisine", "controller=none", "evaluation=none",
        "disturbance=noise", "identifier=ls", "identifier.basis=linear",
    )  # fmt: skip
    widths = {}
    for asked in ("true", "false"):
        results = trials.run(asked_for(*options, f"model_error={asked}"))
        series = next(s for s in results.series if s.kind == "prediction")
        widths[asked] = np.mean(series.columns["surge_identified_std"])
        assert series.units["x_identified_std"] == "m"
        numbers = [row.name for row in results.diagnostics if row.name == "model_error_lambda"]
        assert bool(numbers) == (asked == "true")
    assert widths["false"] < 0.5 * widths["true"]
