"""A table moved to the physical constraints, and the distribution of what was moved."""

from dataclasses import replace

import numpy as np
import pytest

from seatrial.models.errors import IdentificationError
from seatrial.models.identification.residual import ResidualOptions
from seatrial.models.identification.uncertainty import ParameterSpread
from seatrial.models.vessel import basis


def test_a_moved_table_has_the_spread_of_tables_moved_likewise(lap, identifier, rng) -> None:
    """Noise makes the estimate unsymmetric: moved, it is symmetric, and so is every draw."""
    problem = lap("noise", 0).problem
    free = identifier("iv", inertia_factor=None).identify(problem, rng)
    moved = identifier("iv", inertia_factor=5.0).identify(problem, rng)
    assert isinstance(moved.spread, ParameterSpread)
    assert free.model.inertia[0, 1] != free.model.inertia[1, 0]  # nominal to be equal
    for model in (moved.model, *moved.draws(5)):
        np.testing.assert_allclose(model.inertia[0], model.inertia[:, 0], rtol=1e-9)
    errors = replace(moved.residual, theta=moved.std_error)
    np.testing.assert_allclose(errors.row("v_dot")[0], errors.row("u_dot")[1], rtol=1e-9)
    deviations = np.std([m.on(moved.residual.terms).theta for m in moved.draws(3000)], axis=0)
    inside = moved.std_error > 0.0
    np.testing.assert_allclose(deviations[inside], moved.std_error[inside], rtol=0.1)


def test_least_squares_keeps_the_errors_of_the_estimate(lap, identifier, rng) -> None:
    """Its interval is that of the estimate, whatever the constraints."""
    problem = lap("noise", 0).problem
    free, moved = (
        identifier("ls", inertia_factor=factor).identify(problem, rng) for factor in (None, 5.0)
    )
    np.testing.assert_array_equal(free.std_error, moved.std_error)


def test_the_regressors_are_evaluated_once(lap, identifier, rng, monkeypatch) -> None:
    """For the estimate and the constraints; the ferry's terms are among those of the basis."""
    calls: list[int] = []
    evaluated = ResidualOptions.samples

    def counted(*arguments, **options):
        calls.append(1)
        return evaluated(*arguments, **options)

    monkeypatch.setattr(ResidualOptions, "samples", counted)
    for basis_of_terms in ("full", "physical"):
        calls.clear()
        identifier("ls", basis=basis_of_terms).identify(lap("noise", 0).problem, rng)
        assert len(calls) == 1


def test_the_recording_decides_about_the_wind(lap, identifier, rng) -> None:
    calm = lap("calm").problem
    blowing = rng.normal([3.0, 1.0], 0.5, (len(calm.training), 2))
    windy = replace(calm, training=replace(calm.training, wind=blowing))
    options = identifier("iv")
    assert options.wind_measurement is None
    terms = {
        name: options.with_wind(problem).terms(problem.nominal)
        for name, problem in (("windy", windy), ("calm", calm))
    }
    assert {*terms["windy"]} - {*terms["calm"]} == {*basis.terms(["V_qu_q", "V_qv_q", "u_qv_q"])}
    assert basis.term("V_qu_q") in options.identify(windy, rng).residual.terms
    with pytest.raises(IdentificationError, match="the recording has no measured wind"):
        identifier("iv", wind_measurement=True).identify(calm, rng)
