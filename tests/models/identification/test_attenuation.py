"""Warnings of attenuation: where it happens, its size against the measured bias, and the remedy."""

from dataclasses import replace

import numpy as np
import pytest
import scipy

from seatrial.models.identification.constrained_table import attenuations, noise_like, noticeable
from seatrial.models.identification.residual import Samples
from seatrial.models.recording.signals import central_difference
from seatrial.models.vessel.basis import terms
from seatrial.models.vessel.table import Vessel
from seatrial.runner.trials import trial as trials
from tests.trials import composed, excited

STRAIGHT = {"basis": "physical", "inertia_factor": None}


def shares(found):
    return {(f.dof, f.label): f.value for f in found.diagnostics if f.name == "attenuation"}


def test_one_regressor_keeps_the_share_of_signal() -> None:
    """Textbook: beta var(x) / (var(x) + var(e)); Fuller (1987), eq. (1.1.7)."""
    rng = np.random.default_rng(0)
    x = 2.0 * rng.standard_normal((100_000, 1))
    once = x + rng.standard_normal(x.shape)
    again = once + rng.standard_normal(x.shape)
    kept = float(np.linalg.lstsq(once, x, rcond=None)[0][0, 0])
    assert attenuations(once, again)[0] == pytest.approx(1.0 / 5.0, rel=0.02)
    assert kept == pytest.approx(1.0 - attenuations(once, again)[0], rel=0.02)


def test_a_loss_counts_beyond_the_interval_of_all_together() -> None:
    """Bonferroni: of five coefficients each has the interval of 99 %."""
    own, ones, force = terms(["u", "v", "r", "uv", "ur"]), np.ones((5, 1)), np.arange(4.0)[:, None]
    samples = Samples(own, np.ones((4, 5)), force, force)
    nominal = Vessel("one", ("surge",), own, ones)
    for share, noticed in ((0.99, 0), (1.01, 5)):
        errors = 0.2 / (share * 2.576) * ones
        assert len(noticeable(samples, 0.2 * ones[:, 0], nominal, errors)) == noticed


METHODS = {
    "central": lambda nu: central_difference(nu, 0.1),
    "savitzky_golay": lambda nu: scipy.signal.savgol_filter(nu, 7, 2, deriv=1, delta=0.1, axis=0),
}


@pytest.mark.parametrize("method", ["measured", *METHODS])
def test_noise_like_that_of_the_recording(calm, method: str) -> None:
    """Known noise added to the calm lap; that of a derivative goes through the differentiation."""
    rng, clean = np.random.default_rng(1), calm.problem.training
    deviations = np.array([0.05, 0.05, 0.003]), np.array([0.02, 0.02, 0.01])
    e, e_dot = (size * rng.standard_normal(clean.nu.shape) for size in deviations)
    nu, nu_dot = clean.nu + e, clean.nu_dot + e_dot
    if method != "measured":
        nu_dot, e_dot = METHODS[method](nu), METHODS[method](e)
    noisy = replace(clean, nu=nu, nu_dot=nu_dot)
    velocity, acceleration = noise_like(noisy, np.random.default_rng(0))
    np.testing.assert_allclose(np.std(velocity, axis=0), np.std(e, axis=0), rtol=0.1)
    np.testing.assert_allclose(np.std(acceleration, axis=0), np.std(e_dot, axis=0), rtol=0.15)


def test_unfiltered_noise_warns_and_the_bias_is_the_one_predicted(identifier, lap) -> None:
    option = identifier("ls", lowpass_hz=None, **STRAIGHT)
    found = [option.identify(lap("noise", seed).problem, None) for seed in range(4)]
    truth = lap("noise", 0).truth
    (warning,) = found[0].warnings
    (dof, term), predicted = next(iter(shares(found[0]).items()))
    assert f"attenuates {dof}.{term} by {100.0 * predicted:.0f} %" in warning
    assert "identifier.lowpass_hz=auto or identifier=robust or identifier=iv" in warning
    kept = [one.model.coefficient(dof, term) / truth.coefficient(dof, term) for one in found]
    assert 0.5 < (1.0 - np.mean(kept)) / predicted < 2.0
    inertia = [one.model.inertia[0, 0] / truth.inertia[0, 0] for one in found]
    assert 0.5 < (1.0 - np.mean(inertia)) / shares(found[0])["surge", "u_dot"] < 2.0


@pytest.mark.parametrize("lowpass_hz", ["auto", None])
def test_no_warning_without_noise(identifier, calm, lowpass_hz: str | None) -> None:
    found = identifier("ls", lowpass_hz=lowpass_hz, **STRAIGHT).identify(calm.problem, None)
    assert found.warnings == ()
    assert shares(found) == {}


@pytest.mark.parametrize(("lowpass_hz", "warned"), [("auto", False), ("null", True)])
@pytest.mark.parametrize("excitation", ["multisine", "prbs"])
def test_automatic_smoothing_leaves_nothing_to_warn_of(
    excitation: str, lowpass_hz: str, warned: bool
) -> None:
    options = (
        "disturbance=noise", f"excitation={excitation}", "controller=none", "evaluation=none",
        "identifier=ls", "identifier.basis=physical", f"identifier.lowpass_hz={lowpass_hz}",
    )  # fmt: skip
    for seed in range(2):
        problem, _ = excited(*options, seed=seed)
        assert bool(composed(*options).identifier.identify(problem, None).warnings) == warned


def test_automatic_smoothing_on_a_lap_in_closed_loop(identifier, lap) -> None:
    """There lambda is too large, as the module says: up to 12 % of one term, 75 % without."""
    for seed in range(3):
        found = identifier("ls", **STRAIGHT).identify(lap("noise", seed).problem, None)
        assert set(shares(found)) <= {("sway", "ur")}
        assert max(shares(found).values(), default=0.0) < 0.12


def test_the_ferry_of_ten_kilograms_warns(identifier, lap) -> None:
    """Noisy velocities, differentiated: a log gave 10.0 +- 2.5 kg for a ferry of 2,390 kg."""
    problem = lap("noise", 0).problem
    derived = central_difference(problem.training.nu, 0.1)
    problem = replace(problem, training=replace(problem.training, nu_dot=derived))
    found = identifier("ls", lowpass_hz=None, **STRAIGHT).identify(problem, None)
    truth = lap("noise", 0).truth
    assert found.model.inertia[0, 0] < 0.02 * truth.inertia[0, 0]
    assert found.std_error[found.residual.terms.index(terms(["u_dot"])[0]), 0] < 25.0
    assert shares(found)["surge", "u_dot"] > 0.85
    assert "attenuates surge.u_dot by" in found.warnings[0]


@pytest.mark.parametrize(
    ("name", "options", "remedies"),
    [
        ("ls", {}, "identifier=robust or identifier=iv"),
        ("ridge", {"lowpass_hz": 1.0}, "lowpass_hz=auto or identifier=robust or identifier=iv"),
        ("plsr", {"bootstrap": None, "lowpass_hz": None}, "lowpass_hz=auto or identifier=robust"),
        ("iv", {"instruments": "none", "lowpass_hz": None}, "robust or identifier.instruments=sim"),
        ("iv", {"lowpass_hz": None}, None),
        ("ls", {"refinement": "free_run", "lowpass_hz": None}, None),
    ],
)
def test_remedies_are_those_that_the_options_do_not_have(
    identifier, lap, name: str, options: dict[str, object], remedies: str | None
) -> None:
    option = identifier(name, **({"basis": "physical"} | options))
    if remedies is None:
        assert option.noise_remedies == ()
        return
    assert remedies in " or ".join(option.noise_remedies)
    if option.lowpass_hz is None:
        found = option.identify(lap("noise", 0).problem, np.random.default_rng(0))
        assert len(found.warnings) == 1
        assert remedies in found.warnings[0]


def test_a_trial_logs_the_warning(caplog: pytest.LogCaptureFixture) -> None:
    options = ("disturbance=noise", "controller=pid_ff", "evaluation=none", "identifier=ls")
    trials.run(composed(*options, "identifier.lowpass_hz=null", "identifier.basis=physical"))
    (line,) = [one for one in caplog.messages if "attenuates" in one]
    assert line.startswith("identification: noise in the regressors attenuates ")
    assert "identifier.lowpass_hz=auto" in line
