"""What a trial refuses before any work, and what it keeps when a deployment runs away."""

from pathlib import Path

import numpy as np
import pytest

from seatrial.models.errors import ConfigurationError, SeatrialError
from seatrial.models.notation import PLANAR
from seatrial.models.vessel.kinematics import in_body
from seatrial.runner.record.rows import Results
from seatrial.runner.trials import trial as trials
from tests.trials import asked_for, composed

REFUSED = (
    (["identifier=plsr", "identifier.lowpass_hz=9"], "identifier.lowpass_hz must lie between 0"),
    (["controller=none"], "controller=none: excitation=waypoints needs a controller"),
    (["vessel=surge_linear", "excitation=waypoints"], "excitation=waypoints: a lap of way-points"),
    (["vessel=surge_linear", "excitation=zigzag"], "excitation=zigzag: .* surge and yaw"),
    (
        ["vessel=beluga_full", "excitation=prbs", "disturbance=rough"],
        r"disturbance=rough: disturbance\.wind\.windage: got null, expected wind areas",
    ),
    (
        ["excitation=prbs", "vessel.thruster.amplitude_limit=[50.0,500.0,500.0]"],
        r"excitation\.amplitude\.surge: the signal reaches 100, expected .* 50",
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


def test_the_realised_disturbances_are_stored(rough: Results) -> None:
    (series,) = [one for one in rough.series if one.kind == "recording"]
    columns, units = series.columns, series.units
    varying = {
        "wind_north": "m/s", "wind_east": "m/s", "wind_surge": "N", "wind_yaw": "Nm",
        "current_north": "m/s", "current_east": "m/s", "wave_x": "m", "wave_psi": "rad",
        "process_u_dot": "m/s^2", "process_r_dot": "rad/s^2", "noise_x": "m", "noise_psi": "rad",
        "noise_u": "m/s", "noise_r": "rad/s", "noise_u_dot": "m/s^2", "noise_wind_ahead": "m/s",
    }  # fmt: skip
    for name, unit in varying.items():
        assert units[name] == unit
        assert np.std(columns[name]) > 0.0, name
    np.testing.assert_array_equal(columns["force_ned_surge"], 200.0)
    assert units["force_ned_surge"] == "N"


def test_what_is_stored_explains_the_motion(rough: Results) -> None:
    """The plant's table with the stored weather gives the force that acted, to rounding."""
    trial = composed("disturbance=rough", "excitation=prbs")
    c = next(one.columns for one in rough.series if one.kind == "recording")
    pick = {k: np.column_stack([c[n] for n in v]) for k, v in {
        "nu": "uvr", "pose": ("x", "y", "psi"), "nu_dot": ("u_dot", "v_dot", "r_dot"),
    }.items()}  # fmt: skip
    noise = {k: np.column_stack([c[f"noise_{n}"] for n in v]) for k, v in {
        "nu": "uvr", "nu_dot": ("u_dot", "v_dot", "r_dot"),
    }.items()}  # fmt: skip
    psi = c["psi"] - c["noise_psi"] - c["wave_psi"]
    nu, nu_dot = pick["nu"] - noise["nu"], pick["nu_dot"] - noise["nu_dot"]
    nu_dot -= np.column_stack([c[f"process_{n}"] for n in ("u_dot", "v_dot", "r_dot")])
    stream = in_body(np.column_stack([c["current_north"], c["current_east"]]), psi)
    through, rate = nu.copy(), nu_dot.copy()
    through[:, :2] -= stream
    rate[:, 0] -= nu[:, 2] * stream[:, 1]  # a stream turns in body axes
    rate[:, 1] += nu[:, 2] * stream[:, 0]
    plant = trial.plant_scale * trial.vessel.nominal()
    needed = plant.inverse(rate, through)
    wind = np.column_stack([c[f"wind_{dof}"] for dof in PLANAR])
    push = in_body(np.column_stack([c["force_ned_surge"], c["force_ned_sway"]]), psi)
    acting = np.column_stack([c[f"tau_actual_{dof}"] for dof in PLANAR]) + wind
    acting[:, :2] += push
    np.testing.assert_allclose(needed, acting, atol=1e-8)


def test_forces_that_the_thrusters_cannot_give_are_flagged(rough: Results) -> None:
    (flag,) = [one for one in rough.metrics if one.name == "unreached_share"]
    assert (flag.stage, flag.model, flag.dof) == ("identification", "plant", "all")
    assert flag.value is not None
    columns = next(one.columns for one in rough.series if one.kind == "recording")
    given, asked = (
        np.column_stack([columns[f"{name}_{dof}"] for dof in PLANAR])
        for name in ("tau", "tau_asked")
    )
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
    def series(identifier: str) -> dict[str, object]:
        options = (f"identifier={identifier}", "disturbance=rough", "seed=2", "evaluation=none")
        results = trials.run(composed(*options))
        columns = next(s.columns for s in results.series if s.kind == "recording")
        return dict(columns)

    ours, theirs = series("none"), series("ls")
    assert ours.keys() == theirs.keys()
    assert all((ours[name] == theirs[name]).all() for name in ours)  # type: ignore[attr-defined]
