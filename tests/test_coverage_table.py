"""The table of coverages counts as it says."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import norm

from docs.coverage import (
    Case,
    Count,
    Model,
    Share,
    covered,
    proportion,
    read,
    setting,
    shares_of,
    shown,
    total,
    write,
)
from seatrial.models.identification.problem import Identified
from seatrial.models.vessel.table import Vessel
from tests.trials import composed


def estimated(truth: Vessel, nominal: Vessel, size: float, claimed: float, seed: int) -> Identified:
    """An unbiased estimate with normal errors; its standard errors are `claimed` times the true."""
    rng = np.random.default_rng(seed)
    deviation = size * np.abs(truth.theta)
    theta = truth.theta + deviation * rng.standard_normal(truth.theta.shape)
    model = Vessel("identified", truth.dofs, truth.terms, theta)
    residual = Vessel("residual", truth.dofs, truth.terms, theta - nominal.theta)
    return Identified(model, residual, claimed * deviation)


@pytest.mark.parametrize("claimed", [1.0, 0.5, 2.0])
def test_an_estimator_of_known_coverage_has_it(claimed: float) -> None:
    nominal = composed("vessel=milliampere").vessel.nominal()
    truth = 0.5 * nominal
    found = total(
        [covered(estimated(truth, nominal, 0.1, claimed, s), nominal, truth) for s in range(400)]
    )
    expected = 2.0 * norm.cdf(1.96 * claimed) - 1.0
    for inside, counted in found:
        deviation = np.sqrt(expected * (1.0 - expected) / counted)
        assert counted > 400
        assert inside / counted == pytest.approx(expected, abs=4.0 * deviation)


def test_only_true_coefficients_with_a_standard_error_are_counted() -> None:
    nominal = composed("vessel=milliampere").vessel.nominal()
    truth = 0.5 * nominal
    exact = estimated(truth, nominal, 0.0, 1.0, 0)
    errors = np.ones_like(truth.theta)  # of coefficients that are zero too
    everything = covered(Identified(exact.model, exact.residual, errors), nominal, truth)
    assert everything.inertia[1] + everything.damping[1] == np.count_nonzero(truth.theta)
    assert everything.inertia[0] == everything.inertia[1]
    unknown = Identified(exact.model, exact.residual, np.full_like(errors, np.nan))
    assert covered(unknown, nominal, truth) == Count((0, 0), (0, 0))
    assert covered(Identified(exact.model, exact.residual), nominal, truth) == total([])


def test_the_interval_of_a_share_is_that_of_wilson() -> None:
    """81 of 263 have the interval 0.2553 to 0.3662: Newcombe (1998), Table I, method 3."""
    assert proportion((81, 263)) == "0.31 (0.26 to 0.37)"
    assert proportion((0, 0)) == "-"


def test_a_share_is_read_as_it_was_written_and_marked(tmp_path: Path) -> None:
    case, count = Case("milliampere", "[wind,noise]"), Count((9, 10), (19, 20))
    ls, robust = (Share(case, name, name == "robust", 5, 2, count) for name in ("ls", "robust"))
    file = tmp_path / "coverage.json"
    write([ls, robust], file)
    assert read(file) == [robust, ls]  # in the order of the identifiers
    again = replace(robust, seeds=100)
    write([again], file)  # the other stays
    assert read(file) == [again, ls]
    assert "| `milliampere` | wind + noise | `ls` | of the estimate | 0.90 (" in shown(read(file))
    assert "| `robust` | coefficient |" in shown(read(file))


def test_models_are_counted_by_what_they_say_of_their_intervals() -> None:
    """Two models of three have an interval of the coefficient; a fourth seed has no model."""
    case, good, poor = Case("ferry", "noise"), Count((5, 5), (9, 10)), Count((0, 5), (3, 10))
    models = [Model(True, good), Model(False, poor), Model(True, good)]
    assert shares_of(case, "output_error", models, 1) == [
        Share(case, "output_error", True, 2, 1, Count((10, 10), (18, 20))),
        Share(case, "output_error", False, 1, 1, poor),
    ]
    (failed,) = shares_of(case, "iv", [], 4)
    assert (failed.seeds, failed.failed) == (0, 4)


def test_every_identifier_says_what_its_interval_is_of() -> None:
    _, identifiers = setting(Case("milliampere", "noise"), ("robust", "iv", "ls", "ridge", "plsr"))
    covers = {name: identifier.interval_covers for name, identifier in identifiers.items()}
    assert covers == {"robust": True, "iv": True, "ls": False, "ridge": False, "plsr": False}
