"""What a trial refuses before any work, warns of, withholds, and keeps when it runs away."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from seatrial.models.errors import ConfigurationError, Diverged, SeatrialError
from seatrial.models.identification.problem import Identified, Identifier, Problem
from seatrial.models.notation import PLANAR
from seatrial.models.vessel.basis import Array, term
from seatrial.models.vessel.kinematics import in_body
from seatrial.runner.record.rows import Results
from seatrial.runner.trials import closed_loop
from seatrial.runner.trials import trial as trials
from tests.trials import asked_for, composed

REFUSED = (
    (["identifier=plsr", "identifier.lowpass_hz=9"], "identifier.lowpass_hz must lie between 0"),
    (["controller=none", "excitation=waypoints"], "excitation=waypoints needs a controller"),
    (["vessel=surge_linear", "excitation=waypoints"], "excitation=waypoints: a lap of way-points"),
    (["vessel=surge_linear", "excitation=zigzag"], "excitation=zigzag: .* surge and yaw"),
    (
        ["vessel=beluga_full", "excitation=prbs", "disturbance=rough"],
        r"disturbance=rough: disturbance\.wind\.windage: got null, expected wind areas",
    ),
    (
        ["excitation=prbs", "vessel.thruster.amplitude_limit=[50.0,500.0,500.0]"],
        r"excitation=prbs: the force reaches 100 in surge, expected .* 50",
    ),
    (["excitation=recording"], "excitation.path: expected a recording, got none"),
    (["controller.kp=[1.0]"], "kp|ki"),
)


def test_refused_before_any_work(subtests: pytest.Subtests) -> None:
    for overrides, message in REFUSED:
        with subtests.test(message), pytest.raises(ConfigurationError, match=message):
            trials.check(composed(*overrides))


def test_without_evaluation_nothing_is_deployed() -> None:
    results = trials.run(composed("evaluation=none", "identifier=ls"))
    assert results.note == "no evaluation (evaluation=none): deployment is skipped"
    assert {row.stage for row in results.metrics} == {"validation"}
    assert {series.kind for series in results.series} == {"recording", "residual", "prediction"}


def test_a_deployment_that_diverges_keeps_what_holds() -> None:
    # least squares on a force that it does not model finds a vessel that does not hold a course
    trial = composed(
        "identifier=ls", "identifier.inertia_factor=null", "deploy_unphysical=true",
        "vessel.velocity_limits=[1.4,1.2,1.0]", "disturbance=constant",
    )  # fmt: skip
    with pytest.raises(
        trials.TrialDiverged, match=r"identified model: .* exceeds .* at t = "
    ) as caught:
        trials.run(trial)
    results = caught.value.results
    deployed = {(row.model, row.name) for row in results.metrics if row.stage == "deployment"}
    assert {model for model, name in deployed if name == "e_pos_mae"} == {"nominal"}
    lost = {name for model, name in deployed if model == "identified"}
    assert lost == {"spectral_radius"}  # of its design, known before it sailed
    assert any(row.name == "force_mse" for row in results.metrics)
    assert caught.value.time_s > 0.0


ROUGH = ("disturbance=rough", "seed=2", "evaluation=none", "excitation.interval_s=10")


@pytest.fixture(scope="module")
def rough() -> Results:
    """An open loop in every disturbance there is, with thrusters that are too weak for it."""
    weak = [f"{{kind: azimuth, position_m: [{x}, 0, 0], ahead_n: 60.0}}" for x in (1.8, -1.8)]
    return trials.run(
        asked_for(
            "disturbance=[rough,process,constant]", "excitation=prbs", "identifier=none",
            "excitation.length_s=60", "vessel.thrusters.method=pseudo_inverse",
            f"vessel.thrusters.thrusters=[{','.join(weak)}]",
        )
    )  # fmt: skip


def recorded(results: Results) -> Mapping[str, Array]:
    return next(one.columns for one in results.series if one.kind == "recording")


def columns(stored: Mapping[str, Array], names: Sequence[str], prefix: str = "") -> Array:
    return np.column_stack([stored[f"{prefix}{name}"] for name in names])


def test_the_realised_disturbances_are_stored(rough: Results) -> None:
    (series,) = [one for one in rough.series if one.kind == "recording"]
    units = series.units
    varying = {
        "wind_north": "m/s", "wind_east": "m/s", "wind_surge": "N", "wind_yaw": "Nm",
        "current_north": "m/s", "current_east": "m/s", "wave_x": "m", "wave_psi": "rad",
        "process_u_dot": "m/s^2", "process_r_dot": "rad/s^2", "noise_x": "m", "noise_psi": "rad",
        "noise_u": "m/s", "noise_r": "rad/s", "noise_u_dot": "m/s^2", "noise_wind_ahead": "m/s",
    }  # fmt: skip
    for name, unit in varying.items():
        assert units[name] == unit
        assert np.std(series.columns[name]) > 0.0, name
    np.testing.assert_array_equal(series.columns["force_ned_surge"], 200.0)
    assert units["force_ned_surge"] == "N"


def test_what_is_stored_explains_the_motion(rough: Results) -> None:
    """The plant's table with the stored weather gives the force that acted, to rounding."""
    trial = composed("disturbance=rough", "excitation=prbs")
    c = recorded(rough)
    rates = ("u_dot", "v_dot", "r_dot")
    nu = columns(c, "uvr") - columns(c, "uvr", "noise_")
    nu_dot = columns(c, rates) - columns(c, rates, "noise_") - columns(c, rates, "process_")
    psi = c["psi"] - c["noise_psi"] - c["wave_psi"]
    stream = in_body(columns(c, ("north", "east"), "current_"), psi)
    through, rate = nu.copy(), nu_dot.copy()
    through[:, :2] -= stream
    rate[:, 0] -= nu[:, 2] * stream[:, 1]  # a stream turns in body axes
    rate[:, 1] += nu[:, 2] * stream[:, 0]
    plant = trial.plant.scale * trial.vessel.nominal()
    needed = plant.inverse(rate, through)
    acting = columns(c, PLANAR, "tau_actual_") + columns(c, PLANAR, "wind_")
    acting[:, :2] += in_body(columns(c, ("surge", "sway"), "force_ned_"), psi)
    np.testing.assert_allclose(needed, acting, atol=1e-8)


def test_forces_that_the_thrusters_cannot_give_are_flagged(rough: Results) -> None:
    (flag,) = [one for one in rough.metrics if one.name == "unreached_share"]
    assert (flag.stage, flag.model, flag.dof) == ("identification", "plant", "all")
    assert flag.value is not None
    c = recorded(rough)
    given, asked = columns(c, PLANAR, "tau_"), columns(c, PLANAR, "tau_asked_")
    less = np.max(np.abs(asked - given), axis=1) > 1e-6
    assert flag.value == np.mean(less) > 0.3
    scale = np.sum(given * asked, axis=1) / np.sum(asked**2, axis=1)
    np.testing.assert_allclose(given, scale[:, None] * asked, atol=1e-7)  # direction kept


def test_a_wind_file_that_does_not_do_is_refused_before_any_work(tmp_path: Path) -> None:
    path = tmp_path / "wind.csv"
    options = ("disturbance=wind", "disturbance.wind.variation=file", "identifier=none")
    trial = composed(*options, f"disturbance.wind.file={path}")
    for text, message in (
        (None, "there is no such file"),
        ("t,speed,direction\n0,5,0\n100,5,0\n", r"expected increasing times .* 0 to 719\.9 s"),
        ("t,speed\n0,5\n", "no column 'direction'"),
    ):
        if text is not None:
            path.write_text(text)
        with pytest.raises(SeatrialError, match=message):
            trials.check(trial)


def test_competitors_meet_the_same_weather() -> None:
    """All that is stored of the excitation is the same to the bit."""
    ours, theirs = (
        recorded(trials.run(composed(f"identifier={name}", *ROUGH))) for name in ("none", "ls")
    )
    assert ours.keys() == theirs.keys()
    for name, column in ours.items():
        np.testing.assert_array_equal(column, theirs[name], err_msg=name)


# What a design shows to be wrong is said before sailing, and kept with the run.

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


def run_away(*_: Any, **__: Any) -> Any:
    raise Diverged("adrift", 0.0, "x")


def told(results: Results) -> list[str]:
    return [str(one.label) for one in results.diagnostics if one.name == "warning"]


@pytest.mark.parametrize("options", [APPENDIX_K, BEAM_WIND], ids=["unsettled", "infeasible"])
def test_it_is_said_before_the_mission_is_sailed(
    options: tuple[str, ...], monkeypatch: Any, caplog: Any
) -> None:
    """A vessel that never gets under way: the warning is there all the same."""

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

    monkeypatch.setattr(closed_loop, "sail", run_away)
    with pytest.raises(trials.TrialDiverged, match="adrift") as lost:
        trials.run(one)
    assert any(SAID[APPENDIX_K] in text for text in told(lost.value.results))


def test_a_run_that_ends_keeps_its_warnings_and_a_design_that_settles_has_none() -> None:
    assert any(SAID[APPENDIX_K] in text for text in told(trials.run(composed(*SHIP, *APPENDIX_K))))
    assert told(trials.run(composed(*SHIP, "controller=lqi", "disturbance=wind"))) == []


# A model that creates energy is stored and flagged, and deployed only if that is asked for.


@dataclass(frozen=True)
class Pushed(Identifier):
    """The true model of the ferry but for a linear damping in surge, which pushes it."""

    damping: float  # [kg/s]

    def identify(self, problem: Problem, rng: np.random.Generator) -> Identified:
        theta = 0.5 * problem.nominal.theta
        theta[problem.nominal.terms.index(term("u")), 0] = self.damping
        model = replace(problem.nominal, theta=theta)
        return Identified(model, model - problem.nominal)


def results_of(damping: float, *overrides: str) -> Results:
    trial = replace(composed("identifier=none", *overrides), identifier=Pushed(damping))
    trials.check(trial)
    return trials.run(trial)


def deployed(results: Results) -> set[str]:
    rows = [row for row in results.metrics if row.name == "e_pos_mae"]
    assert {row.model for row in rows} == {"nominal", "identified"}  # withheld: without a value
    return {row.model for row in rows if row.value is not None}


def flags(results: Results) -> list[str]:
    return [one.label for one in results.diagnostics if one.name == "unphysical"]


def test_it_is_stored_and_flagged_but_not_deployed(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level("WARNING"):
        results = results_of(-200.0)
    (reason,) = flags(results)
    assert reason.startswith("its damping creates energy at ")
    assert results.note is not None
    assert results.note.startswith("the identified model is not deployed: its damping creates")
    assert results.note.endswith("deploy_unphysical=true deploys it")
    assert results.note in caplog.messages
    assert deployed(results) == {"nominal"}
    assert not [one for one in results.series if one.kind == "deployment_identified"]
    assert [one for one in results.series if one.kind == "deployment_nominal"]
    stored = {(row.model, row.dof, row.term): row.value for row in results.coefficients}
    assert stored["identified", "surge", "u"] == pytest.approx(-200.0)


@pytest.mark.parametrize(
    ("damping", "option"), [(-200.0, "deploy_unphysical=true"), (14.0, "deploy_unphysical=false")]
)
def test_it_is_deployed_if_that_is_asked_for_or_it_is_physical(damping: float, option: str) -> None:
    results = results_of(damping, option)
    assert len(flags(results)) == (damping < 0.0)
    assert results.note is None
    assert deployed(results) == {"nominal", "identified"}
