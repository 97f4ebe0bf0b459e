"""What a trial refuses before any work, and what it keeps when a deployment runs away."""

import numpy as np
import pytest

from models.errors import ConfigurationError
from runner import trial as trials
from tests.trials import composed


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["identifier.lowpass_hz=9"], "identifier.lowpass_hz must lie between 0 and 5, got 9"),
        (["controller=none"], "controller=none: excitation=waypoints is sailed by a controller"),
        (["vessel=surge_linear"], "excitation=waypoints needs a vessel in surge, sway, yaw"),
        (["excitation=recording"], "excitation.path: expected a CSV file, got none"),
        (["controller.kp=[1.0]"], "kp|ki"),
    ],
)
def test_refused_before_any_work(overrides: list[str], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        trials.check(composed(*overrides))


def test_without_evaluation_nothing_is_deployed() -> None:
    results = trials.run(composed("evaluation=none", "identifier=ls"))
    assert results.note == "no evaluation (evaluation=none): deployment is skipped"
    assert {row.stage for row in results.metrics} == {"validation"}
    assert {series.kind for series in results.series} == {"recording", "residual"}


def test_a_deployment_that_diverges_keeps_what_holds() -> None:
    # least squares on a force that it does not model finds a vessel that does not hold a course
    trial = composed(
        "identifier=ls", "vessel.velocity_limits=[1.4,1.2,1.0]", "disturbance=constant"
    )
    with pytest.raises(
        trials.TrialDiverged, match=r"identified model: .* exceeds .* at t = "
    ) as caught:
        trials.run(trial)
    results = caught.value.results
    deployed = {row.model for row in results.metrics if row.stage == "deployment"}
    assert deployed == {"nominal"}
    assert any(row.name == "force_mse" for row in results.metrics)
    assert caught.value.time_s > 0.0


def test_the_same_seed_repeats_every_figure() -> None:
    overrides = ("identifier=plsr", "disturbance=noise", "seed=7")
    timed = ("step_time_median", "step_time_p99")

    def figures(*given: str) -> list[float | None]:
        return [r.value for r in trials.run(composed(*given)).metrics if r.name not in timed]

    first = figures(*overrides)
    np.testing.assert_array_equal(first, figures(*overrides))  # NaN equals NaN
    assert not np.array_equal(first, figures(*overrides[:2], "seed=8"), equal_nan=True)


def test_competitors_meet_the_same_weather() -> None:
    def series(identifier: str) -> dict[str, object]:
        results = trials.run(composed(f"identifier={identifier}", "disturbance=rough", "seed=2"))
        columns = next(s.columns for s in results.series if s.kind == "recording")
        return dict(columns)

    ours, theirs = series("none"), series("ls")
    assert ours.keys() == theirs.keys()
    assert all((ours[name] == theirs[name]).all() for name in ours)  # type: ignore[attr-defined]
