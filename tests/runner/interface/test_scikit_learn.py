"""The estimator keeps scikit-learn's rules, and gives the numbers of a trial."""

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.exceptions import NotFittedError
from sklearn.model_selection import GridSearchCV, KFold, cross_val_score
from sklearn.utils import estimator_checks, get_tags

import seatrial as st
from seatrial.models.identification.least_squares import LeastSquares
from tests.trials import composed


@pytest.fixture(scope="module")
def recording(sweep: st.Logbook) -> st.Recording:
    """That of the run in noise with least squares and seed 0."""
    return st.Recording.from_frame(sweep.run(number_of(sweep)).series())


def number_of(sweep: st.Logbook) -> int:
    return int(sweep.runs(where="identifier=ls and seed=0").index[0])


def test_parameters_are_got_set_and_cloned() -> None:
    estimator = st.Estimator("ls", basis="physical")
    assert estimator.get_params() == {
        "identifier": "ls", "vessel": "milliampere", "seed": 0, "basis": "physical",
    }  # fmt: skip
    assert estimator.set_params(basis="full", force="commanded") is estimator
    copy = clone(estimator)
    assert copy is not estimator
    assert copy.get_params() == estimator.get_params()
    assert copy.get_params()["basis"] == "full"
    assert "basis='full'" in repr(copy)
    assert get_tags(copy).estimator_type == "regressor"


@pytest.mark.parametrize(
    "law",
    [
        *("estimator_cloneable", "estimator_repr", "estimator_tags_renamed", "mixin_order"),
        *("no_attributes_set_in_init", "valid_tag_types", "get_params_invariance", "set_params"),
        "parameters_default_constructible",
    ],
)
def test_it_obeys_the_checks_of_scikit_learn_that_fit_nothing(law: str) -> None:
    """The others fit arrays of independent samples, which a recording is not."""
    getattr(estimator_checks, f"check_{law}")("Estimator", st.Estimator())


def test_it_fits_what_a_trial_fits(sweep: st.Logbook, recording: st.Recording) -> None:
    number = number_of(sweep)
    train = sweep.run(number).series()["train"].to_numpy() > 0.0
    estimator = st.Estimator("ls").fit(recording.part(train))
    stored = sweep.model(number).coefficients
    fitted = estimator.model_.coefficients.loc[stored.index]
    np.testing.assert_allclose(fitted, stored, rtol=1e-9, atol=1e-9)  # of coefficients up to 3000
    lag = st.Vessel("milliampere").parameters.thruster
    score = estimator.score(recording.with_thruster(lag).part(~train))
    assert score == pytest.approx(sweep.run(number).metric("velocity_r2_restarts"), rel=1e-9)
    predicted = estimator.predict(recording.part(~train))
    assert len(predicted) == np.count_nonzero(~train)


@pytest.mark.slow
def test_a_search_is_over_blocks_of_time(recording: st.Recording) -> None:
    blocks = recording.blocks(6, gap_s=2.0)
    grid = {"basis": ["physical", "full"]}
    search = GridSearchCV(st.Estimator("ls"), grid, cv=KFold(3)).fit(blocks)
    result = search.cv_results_
    by_hand = [
        st.Estimator("ls", basis="full").fit(blocks[:2] + blocks[4:]).score(blocks[2:4])
    ]  # fmt: skip
    assert result["split1_test_score"][1] == pytest.approx(by_hand[0])
    assert search.best_params_["basis"] == grid["basis"][int(np.argmax(result["mean_test_score"]))]
    assert search.best_estimator_.model_.dofs == ("surge", "sway", "yaw")
    scores = cross_val_score(st.Estimator("ls", basis="full"), blocks, cv=KFold(3))
    np.testing.assert_allclose(scores, [result[f"split{i}_test_score"][1] for i in range(3)])


def test_one_recording_is_not_a_list_of_samples(recording: st.Recording) -> None:
    with pytest.raises(st.ConfigurationError, match=r"recording.blocks\(10\) cuts one"):
        cross_val_score(st.Estimator("ls"), recording, cv=KFold(3))
    with pytest.raises(st.ConfigurationError, match="X: got int, expected recordings"):
        st.Estimator("ls").fit([1, 2])  # type: ignore[list-item]


def test_an_identifier_of_your_own(recording: st.Recording) -> None:
    named = st.Estimator("ls", basis="physical").fit(recording)
    part = composed("identifier=ls", "identifier.basis=physical").identifier
    assert isinstance(part, LeastSquares)
    own = st.Estimator(part).fit(recording)
    np.testing.assert_array_equal(own.model_.coefficients, named.model_.coefficients)
    with pytest.raises(TypeError, match="unexpected keyword argument 'bases'"):
        st.Estimator(part, bases="full").fit(recording)


def test_a_frame_is_a_recording(recording: st.Recording) -> None:
    frame = recording.to_frame()
    own, same = (st.Estimator("ls", basis="physical").fit(x) for x in (frame, [recording]))
    np.testing.assert_array_equal(own.model_.coefficients, same.model_.coefficients)
    assert own.score([frame]) == same.score(recording)
    scores = cross_val_score(st.Estimator("ls", basis="physical"), frame, cv=KFold(3))
    assert np.all(np.isfinite(scores))
    known = ["x", "y", "psi", "u", "v", "r", "tau_surge", "tau_sway", "tau_yaw"]
    array = frame.reset_index()[["t", *known]].to_numpy()
    alike = st.Estimator("ls", basis="physical").fit(frame[known])
    of_array = st.Estimator("ls", basis="physical").fit(array)
    np.testing.assert_array_equal(of_array.model_.coefficients, alike.model_.coefficients)
    scores = cross_val_score(st.Estimator("ls", basis="physical"), array, cv=KFold(3))
    assert np.all(np.isfinite(scores))
    with pytest.raises(st.ConfigurationError, match=r"X: got samples of shape \(9,\), expec"):
        of_array.score(array[:, 1:])


def test_errors_are_one_line(recording: st.Recording) -> None:
    with pytest.raises(st.ConfigurationError, match="identifier: no option 'lss', did you mean ls"):
        st.Estimator("lss").fit(recording)
    with pytest.raises(st.ConfigurationError, match=r"identifier.bases: unknown option"):
        st.Estimator("ls", bases="full").fit(recording)
    with pytest.raises(st.ConfigurationError, match=r"identifier\.selection: got test"):
        st.Estimator("plsr", selection="test").fit(recording)
    with pytest.raises(NotFittedError, match="is not fitted yet"):
        st.Estimator("ls").score(recording)
    with pytest.raises(st.ConfigurationError, match="X: got int, expected recordings"):
        st.Estimator("ls").fit(3)
    with pytest.raises(st.ConfigurationError, match="X: got surge, sway, yaw, expected"):
        st.Estimator("ls", vessel="surge_linear").fit(recording)
