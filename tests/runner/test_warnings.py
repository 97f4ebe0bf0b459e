"""What a controller's design shows to be wrong is said before sailing, and kept with the run."""

import logging
from typing import Any

import pytest

from seatrial.models.errors import Diverged
from seatrial.runner.record.rows import Results
from seatrial.runner.trials import closed_loop
from seatrial.runner.trials import trial as trials
from tests.trials import composed

SHIP = (
    "vessel=supply_vessel", "evaluation=setpoints", "evaluation.duration_s=20",
    "excitation=prbs", "excitation.length_s=10", "sample_time_s=1.0", "integration_step_s=1.0",
    "identifier=none",
)  # fmt: skip
APPENDIX_K = (  # horizon and weights of the source: it is unstable on its own model
    "controller=mpc_integral", "controller.horizon=10", "controller.error_weight=[1e2, 1.0, 1e3]",
)  # fmt: skip
BEAM_WIND = (
    "controller=lqi", "controller.limits=[1e5, 1e5, 1e7]", "disturbance=wind",
    "disturbance.wind.speed_m_s=20", "disturbance.wind.direction_deg=90",
)  # fmt: skip
SAID = {
    APPENDIX_K: "spectral radius is 1.024",
    BEAM_WIND: "infeasible_limits: sway needs up to 2.16e+05 N to stand still, the limit is 1e+05",
}


def told(results: Results) -> list[str]:
    return [str(one.label) for one in results.diagnostics if one.name == "warning"]


@pytest.mark.parametrize("options", [APPENDIX_K, BEAM_WIND], ids=["unsettled", "infeasible"])
def test_it_is_said_before_the_mission_is_sailed(
    options: tuple[str, ...], monkeypatch: Any, caplog: Any
) -> None:
    """A vessel that never gets under way: the warning is there all the same."""

    def run_away(*_: Any, **__: Any) -> Any:
        raise Diverged("adrift", 0.0, "x")

    one = composed(*SHIP, *options)
    excited = trials.excite(one, closed_loop.Streams(0))
    monkeypatch.setattr(trials, "excite", lambda *_: excited)
    monkeypatch.setattr(closed_loop, "sail", run_away)
    with caplog.at_level(logging.WARNING), pytest.raises(trials.TrialDiverged) as lost:
        trials.run(one)
    assert any(SAID[options] in record.getMessage() for record in caplog.records)
    assert any(SAID[options] in text for text in told(lost.value.results))
    names = {metric.name for metric in lost.value.results.metrics}
    assert {"spectral_radius", "infeasible_limits"} <= names


def test_an_excitation_that_runs_away_keeps_what_its_controller_showed(monkeypatch: Any) -> None:
    options = [text for text in SHIP if not text.startswith("excitation.")]
    one = composed(*options, *APPENDIX_K, "excitation=waypoints")

    def run_away(*_: Any, **__: Any) -> Any:
        raise Diverged("adrift", 0.0, "x")

    monkeypatch.setattr(closed_loop, "sail", run_away)
    with pytest.raises(trials.TrialDiverged, match="adrift") as lost:
        trials.run(one)
    assert any(SAID[APPENDIX_K] in text for text in told(lost.value.results))


def test_a_run_that_ends_keeps_its_warnings_and_a_design_that_settles_has_none() -> None:
    assert any(SAID[APPENDIX_K] in text for text in told(trials.run(composed(*SHIP, *APPENDIX_K))))
    assert told(trials.run(composed(*SHIP, "controller=lqi", "disturbance=wind"))) == []
