"""The tables of coverages and of bands count as they say."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import norm

from docs import bands, coverage
from docs.bands import Row, Scored, scored
from docs.coverage import Case, Count, Model, Share, covered, shown, total
from seatrial.models.identification.model_error import ModelError
from seatrial.models.identification.problem import Identified, NoIdentifier
from seatrial.models.identification.validation import prediction
from seatrial.models.vessel.table import Vessel
from tests.trials import composed, excited


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
    assert coverage.proportion((81, 263)) == "0.31 (0.26 to 0.37)"
    assert coverage.proportion((0, 0)) == "-"


def test_a_share_is_read_as_it_was_written_and_marked(tmp_path: Path) -> None:
    case, count = Case("milliampere", "[wind,noise]"), Count((9, 10), (19, 20))
    ls, robust = (Share(case, name, name == "robust", 5, 2, count) for name in ("ls", "robust"))
    file = tmp_path / "coverage.json"
    coverage.write([ls, robust], file)
    assert coverage.read(file) == [robust, ls]  # in the order of the identifiers
    again = replace(robust, seeds=100)
    coverage.write([again], file)  # the other stays
    assert coverage.read(file) == [again, ls]
    table = shown(coverage.read(file))
    assert "| `milliampere` | wind + noise | `ls` | of the estimate | 0.90 (" in table
    assert "| `robust` | coefficient |" in table


def test_models_are_counted_by_what_they_say_of_their_intervals() -> None:
    """Two models of three have an interval of the coefficient; a fourth seed has no model."""
    case, good, poor = Case("ferry", "noise"), Count((5, 5), (9, 10)), Count((0, 5), (3, 10))
    models = [Model(True, good), Model(False, poor), Model(True, good)]
    assert coverage.shares_of(case, "output_error", models, 1) == [
        Share(case, "output_error", True, 2, 1, Count((10, 10), (18, 20))),
        Share(case, "output_error", False, 1, 1, poor),
    ]
    (failed,) = coverage.shares_of(case, "iv", [], 4)
    assert (failed.seeds, failed.failed) == (0, 4)


def test_every_identifier_says_what_its_interval_is_of() -> None:
    names = ("robust", "iv", "ls", "ridge", "plsr")
    _, identifiers = coverage.setting(Case("milliampere", "noise"), names)
    covers = {name: identifier.interval_covers for name, identifier in identifiers.items()}
    assert covers == {"robust": True, "iv": True, "ls": False, "ridge": False, "plsr": False}


SURGE = ("vessel=surge_linear", "excitation=multisine", "controller=none", "evaluation=none")


def test_every_file_is_left_out_once(tmp_path: Path) -> None:
    for name in "abc":
        (tmp_path / f"{name}.dat").touch()
    train = json.dumps([str(tmp_path / "b.dat")])
    words = (f"excitation.train={train}", "seed=0", "excitation.test=[]")
    found = dict(bands.left_out_in_turn(words))
    assert sorted(found) == ["a", "b", "c"]
    for name, options in found.items():
        given = {key: value for key, _, value in (each.partition("=") for each in options)}
        files = [Path(each).stem for each in json.loads(given["excitation.train"])]
        assert sorted([*files, name]) == ["a", "b", "c"]
        assert [Path(each).stem for each in json.loads(given["excitation.test"])] == [name]
        assert given["seed"] == "0"


@pytest.mark.parametrize("deviation", [0.5, 1.0])
def test_white_errors_of_known_size_are_counted(deviation: float) -> None:
    """A band of noise alone, of the right size and of half of it, with its width and CRPS."""
    own, _ = excited(*SURGE, "disturbance=calm")
    run = prediction(own.nominal, own.validation, None)
    spread, rng = run.mean_motion(), np.random.default_rng(0)
    white = 0.1 * spread * rng.standard_normal((len(own.validation), 2))
    white[0] = 0.0  # the run begins at the true state
    motion = run.motion() + white
    noisy = replace(own.validation, eta=motion[:, :1], nu=motion[:, 1:])
    error = ModelError(1.0, np.zeros(1), 1.0, np.zeros(1), deviation * 0.1 * spread)
    result = NoIdentifier().identify(own, rng)
    problem = replace(own, validation=noisy)
    done = scored(replace(result, model_error=error), problem, None)
    assert done is not None
    inside = 0.90 if deviation == 1.0 else 0.589
    n = len(noisy) - 1
    assert done.velocity.states == n
    assert done.velocity.inside / n == pytest.approx(inside, abs=0.02)
    moved = np.std(noisy.nu) / spread[1]
    assert done.velocity.width / n == pytest.approx(3.29 * deviation * 0.1 / moved, rel=0.1)
    assert done.measures == (0, 0)


def test_rows_are_kept_and_replaced_by_case(tmp_path: Path) -> None:
    part = Scored(bands.Count(10, 9.0, 20.0, 1.0), bands.Count(10, 5.0, 40.0, 4.0), (3, 4))
    row = Row("ferry", "noise 0", "auto", part, part, 1.5, (60.0, 20.0))
    file = tmp_path / "bands.json"
    bands.write(
        [row, replace(row, case="noise 1", both=None, fit=(10.0, 30.0), note="it diverges")], file
    )
    bands.write([replace(row, seconds=2.5)], file)
    kept = bands.read(file)
    assert [(each.case, each.seconds) for each in kept] == [("noise 0", 2.5), ("noise 1", 1.5)]
    assert kept[0].both == part
    line = bands.shown(kept).splitlines()[-1]
    assert "0.90, 2.00, 0.100" in line
    assert "3 of 4" in line
    assert "1 of 2 |" in line  # cases
    assert "35.0, 25.0, 1 of 2" in line  # FIT


def test_crps_is_the_integral_of_the_squared_difference_of_distributions() -> None:
    """By its definition; without a spread it is the absolute error."""
    x = np.linspace(-20.0, 20.0, 40001)
    for error, deviation in ((0.0, 1.0), (1.5, 0.7), (-3.0, 2.0)):
        cumulated = np.cumsum(np.exp(-0.5 * (x / deviation) ** 2)) * (x[1] - x[0])
        cumulated /= cumulated[-1]
        expected = np.sum((cumulated - (x >= error)) ** 2) * (x[1] - x[0])
        own = bands.crps(np.array([error]), np.array([deviation]))[0]
        assert own == pytest.approx(expected, rel=2e-3)
    assert bands.crps(np.array([-2.0]), np.array([0.0]))[0] == pytest.approx(2.0)
    assert bands.half_width(np.array([2.0]))[0] == pytest.approx(2.0 * 1.6449, rel=1e-4)
