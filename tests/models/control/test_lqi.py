"""LQ control with integral action against Riccati, another library, and what it promises."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from seatrial.models.control.linear_controller import lqi_gain
from seatrial.models.control.linear_design import design_model
from seatrial.models.errors import ConfigurationError
from seatrial.models.simulation.statespace import spectral_radius
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.derivatives import from_derivatives
from tests.models.control.sailing import (
    ERROR_WEIGHT,
    INCREMENT_WEIGHT,
    LIMITS,
    WINDAGE,
    appendix_k,
    double_integrators,
    lqi,
    mpc,
    note,
    ship,
    steady,
    voyage,
    weather,
)

Q, P = np.diag(ERROR_WEIGHT), np.diag(INCREMENT_WEIGHT)


def test_the_gain_is_the_regulator_of_the_augmented_model() -> None:
    model = design_model(ship(), LIMITS, 1.0).model
    plus = model.with_integral_action()
    gain = lqi_gain(model, Q, P)
    control: Any = pytest.importorskip("control")
    expected, _, poles = control.dlqr(plus.A, plus.B, plus.C.T @ Q @ plus.C, P)
    np.testing.assert_allclose(gain, -expected, rtol=1e-6, atol=1e-9)
    radius = spectral_radius(plus.A + plus.B @ gain)
    assert radius == pytest.approx(np.max(np.abs(poles)), rel=1e-9)
    assert note(lqi(), "spectral_radius") == pytest.approx(radius, rel=1e-9)
    assert radius < 1.0
    assert note(lqi(), "estimator_radius") < 1.0


@pytest.mark.parametrize("make", [lqi, lambda **k: mpc("integral", **k)])
def test_integral_action_leaves_no_error_against_a_constant_wind(make: Any) -> None:
    n = 1200
    met = weather(n, wind_ned=steady(n, 12.0, 1.0), current_ned=np.tile([0.4, -0.3], (n, 1)))
    for wind in (WINDAGE, None):  # known or not
        sailed, _ = voyage(make(wind=wind), appendix_k(n), met=met)
        for rows in (slice(500, 560), slice(1140, 1200)):
            error = (sailed.log.eta_d - sailed.log.eta)[rows]
            assert np.all(np.abs(error.mean(axis=0)) < [0.02, 0.02, np.radians(0.01)])


@pytest.mark.parametrize(
    "make", [lqi, lambda: mpc("condensed"), lambda: mpc("integral"), lambda: mpc("reduced")]
)
def test_no_heading_is_special(make: Any) -> None:
    """Turn pose, set-points, wind and current by one angle: the voyage is turned by it."""
    n, angle = 400, 2.0
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s], [s, c]])

    def turned(rows: Array, heading: float = 0.0) -> Array:
        pairs = rows[:, :2] @ turn.T
        return np.column_stack([pairs, rows[:, 2:] + heading])

    setpoints = appendix_k(n)
    wind, current = steady(n, 10.0, 0.5), steady(n, 0.5, -1.0)
    start = np.array([1.0, -2.0, 0.1])
    one, _ = voyage(
        make(), setpoints, met=weather(n, wind_ned=wind, current_ned=current), start=start
    )
    other, _ = voyage(
        make(),
        turned(setpoints, angle),
        met=weather(n, wind_ned=turned(wind), current_ned=turned(current)),
        start=turned(start[None], angle)[0],
    )
    np.testing.assert_allclose(turned(one.log.eta, angle), other.log.eta, atol=1e-5)
    np.testing.assert_allclose(one.log.tau / LIMITS, other.log.tau / LIMITS, atol=1e-5)


def test_a_whole_turn_of_the_set_point_is_no_turn() -> None:
    n = 200
    setpoints = np.tile([0.0, 0.0, 0.2], (n, 1))
    again = setpoints + np.array([0.0, 0.0, 2.0 * np.pi])
    for make in (lqi(), mpc("integral"), mpc("condensed")):
        one, other = (voyage(make, points)[0].log.eta for points in (setpoints, again))
        np.testing.assert_allclose(one, other, atol=1e-7)


def test_nothing_winds_up_at_a_limit() -> None:
    """However long the command stood at its limit, it leaves it as soon as the error turns."""
    samples = []
    for waited in (20, 2000):
        side = np.where(np.arange(waited + 100) < waited, 1.0, -1.0)
        setpoints = np.outer(side, [10.0, 10.0, 0.2])
        log = voyage(lqi(estimator="measured"), setpoints, plant=1e9 * ship())[0].log  # stays
        turned = int(np.argmax(log.eta_d[:, 0] < 0.0))
        np.testing.assert_allclose(log.tau[turned - 1], LIMITS)
        within = np.all(np.abs(log.tau[turned:]) < LIMITS, axis=1)
        samples.append(int(np.flatnonzero(within)[0]))
    assert samples[0] == samples[1] <= 1


def test_commands_are_held_between_own_samples() -> None:
    n = 400
    sailed, state = voyage(lqi(period_s=2.0), appendix_k(n), period_s=0.5)
    tau = sailed.log.tau.reshape(-1, 4, 3)
    assert np.all(tau == tau[:, :1])
    assert len(np.unique(tau[:, 0, 0])) > 10
    assert state.instant[0] == n
    with pytest.raises(ConfigurationError, match="expected a multiple of sample_time_s"):
        lqi(period_s=0.7).build(ship(), 0.5)


@pytest.mark.nightly
def test_a_vessel_of_one_axis_is_controlled_too() -> None:
    surge = from_derivatives("surge", ("surge",), np.array([[60.0]]), {"X_u": -20.0})
    one = {"limits": (100.0,), "error_weight": (100.0,), "input_weight": (2.4e4,), "wind": None}
    kalman = replace(lqi().kalman, process=(0.05,), measurement=(0.02,), bias_walk=(1.0,))
    force = np.full((600, 1), 5.0)
    for make in (lqi(**one, kalman=kalman), mpc("integral", **one, kalman=kalman)):
        sailed, _ = voyage(
            make, np.full((600, 1), 3.0), model=surge, plant=surge, period_s=0.5,
            met=weather(600, 1, force_ned=force),
        )  # fmt: skip
        assert sailed.log.eta[-1, 0] == pytest.approx(3.0, abs=1e-4)
        assert sailed.log.tau[-1, 0] == pytest.approx(-5.0, abs=1e-3)


def test_a_state_space_model_controls_without_knowing_its_state() -> None:
    """The linear model under a transformation that hides its state, with its innovations gain."""
    design = design_model(double_integrators(), LIMITS, 1.0)
    M, _ = lqi().kalman.gains(design)
    T = np.random.default_rng(1).normal(size=(6, 6))
    hidden = replace(design.model, K=design.model.A @ M).transformed(T)
    hidden = hidden.scaled(np.array(LIMITS), np.ones(3))  # inputs in N again
    n = 600
    small = appendix_k(n) * [0.2, 0.2, 0.0]  # the axes of its data: no turning
    for make in (lqi(wind=None), mpc("integral", wind=None)):
        a, _ = voyage(make, small, model=double_integrators(), plant=double_integrators())
        b, _ = voyage(make, small, model=hidden, plant=double_integrators())
        np.testing.assert_allclose(a.log.eta, b.log.eta, atol=1e-4)
