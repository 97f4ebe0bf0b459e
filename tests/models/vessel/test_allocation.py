"""Allocation: exact where it can be, scaled where it cannot."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linprog

from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import DOFS, PLANAR
from seatrial.models.vessel.allocation import Allocation, PositionedThruster, reached
from seatrial.models.vessel.basis import Array
from tests.trials import composed, sailed

FERRY = (
    PositionedThruster("azimuth", (1.8, 0.0, 0.0), 500.0),
    PositionedThruster("azimuth", (-1.8, 0.0, 0.0), 500.0),
)
SHIP = (
    PositionedThruster("fixed", (-35.0, -4.0, 0.0), 1.5e5, 1.0e5),
    PositionedThruster("fixed", (-35.0, 4.0, 0.0), 1.5e5, 1.0e5),
    PositionedThruster("azimuth", (-25.0, 0.0, 0.0), 2.0e5),
    PositionedThruster("tunnel", (28.0, 0.0, 0.0), 1.2e5),
    PositionedThruster("tunnel", (24.0, 0.0, 0.0), 1.2e5),
)
# Without an azimuth
BARGE = (*SHIP[:2], *SHIP[3:], PositionedThruster("tunnel", (-30.0, 0.0, 0.0), 8e4, 4e4))
METHODS = ("pseudo_inverse", "qp")


def astern(one: PositionedThruster) -> float:
    return one.ahead_n if one.astern_n is None else one.astern_n


def reachable(
    thrusters: tuple[PositionedThruster, ...], count: int, share: float = 0.99, ends: bool = False
) -> Array:
    """Random forces that the thrusters can give, shape (count, n_dof); all at a limit if `ends`."""
    rng = np.random.default_rng(1 if ends else 0)
    u = []
    for one in thrusters:
        if one.kind == "azimuth":
            angle = rng.uniform(0.0, 2 * np.pi, count)
            size = share * one.ahead_n * (1.0 if ends else np.sqrt(rng.random(count)))
            u += [size * np.cos(angle), size * np.sin(angle)]
        else:
            place = rng.random(count)
            place = np.round(place) if ends else place
            u.append(share * (place * (one.ahead_n + astern(one)) - astern(one)))
    T = Allocation("qp", thrusters).matrix(PLANAR)
    return np.asarray((T @ np.array(u)).T)


def assert_within(thrusters: tuple[PositionedThruster, ...], u: Array) -> None:
    rows = iter(u.T)
    for one in thrusters:
        force = next(rows)
        if one.kind == "azimuth":
            force = np.hypot(force, next(rows))
        assert np.all(force <= one.ahead_n * (1 + 1e-7))
        assert np.all(force >= -astern(one) * (1 + 1e-7))


def test_the_matrix_is_the_printed_one() -> None:
    """Bargouth (2022), (2.11) and (2.14): two main propellers, an azimuth and two tunnels."""
    T = Allocation("pseudo_inverse", SHIP).matrix(PLANAR)
    np.testing.assert_allclose(T[0], [1, 1, 1, 0, 0, 0])
    np.testing.assert_allclose(T[1], [0, 0, 0, 1, 1, 1])
    np.testing.assert_allclose(T[2], [4.0, -4.0, 0.0, -25.0, 28.0, 24.0])  # lx Fy - ly Fx


def test_two_azimuths_are_those_of_the_ferry() -> None:
    """Jervan (2020), eq. (5.2): tau_r = (sin a1 f1 - sin a2 f2) l."""
    T = Allocation("qp", FERRY).matrix(PLANAR)
    f, a = np.array([300.0, 200.0]), np.array([0.4, -1.0])
    u = np.column_stack([f * np.cos(a), f * np.sin(a)]).ravel()
    expected = [f @ np.cos(a), f @ np.sin(a), 1.8 * (f[0] * np.sin(a[0]) - f[1] * np.sin(a[1]))]
    np.testing.assert_allclose(T @ u, expected)


@pytest.mark.parametrize("thrusters", [FERRY, SHIP, BARGE])
@pytest.mark.parametrize("method", METHODS)
def test_what_can_be_reached_is_exact(
    thrusters: tuple[PositionedThruster, ...], method: Any
) -> None:
    tau = np.vstack([reachable(thrusters, 300, 1.0 - 1e-6, ends) for ends in (False, True)])
    found = Allocation(method, thrusters).allocate(tau, PLANAR)
    assert np.all(found.reached)
    assert np.max(np.abs(found.applied - tau) / np.max(np.abs(tau), axis=0)) < 1e-9
    assert_within(thrusters, found.u)


@pytest.mark.parametrize("thrusters", [FERRY, SHIP, BARGE])
def test_both_methods_find_the_lightest_forces_and_the_same_share(
    thrusters: tuple[PositionedThruster, ...],
) -> None:
    tau = np.vstack([reachable(thrusters, 100), 3.0 * reachable(thrusters, 100, 1.0)])
    one, other = (Allocation(m, thrusters).allocate(tau, PLANAR) for m in METHODS)  # type: ignore[arg-type]
    shares = [np.sum(f.applied * tau, axis=1) / np.sum(tau**2, axis=1) for f in (one, other)]
    # the program's penalty of 1e-6 on u is exact for flat limits, and for circles nearly
    np.testing.assert_allclose(shares[0], shares[1], rtol=1e-5)
    np.testing.assert_array_equal(one.reached, other.reached)
    # the program weighs shares of the limits, the pseudo-inverse newtons: equal where one size
    if thrusters == FERRY:
        light = one.reached
        np.testing.assert_allclose(one.u[light], other.u[light], atol=0.01)
    lightest = np.sum(one.u[one.reached] ** 2, axis=1)
    assert np.all(lightest <= np.sum(other.u[one.reached] ** 2, axis=1) * (1 + 1e-9))


@pytest.mark.parametrize("thrusters", [FERRY, SHIP, BARGE])
@pytest.mark.parametrize("method", METHODS)
def test_what_cannot_be_reached_keeps_its_direction(
    thrusters: tuple[PositionedThruster, ...], method: Any
) -> None:
    tau = 4.0 * reachable(thrusters, 200, 1.0)
    found = Allocation(method, thrusters).allocate(tau, PLANAR)
    scale = np.sum(found.applied * tau, axis=1) / np.sum(tau**2, axis=1)
    np.testing.assert_allclose(
        found.applied / np.max(np.abs(tau), axis=0),
        scale[:, None] * tau / np.max(np.abs(tau), axis=0),
        atol=1e-9,
    )
    assert np.all((scale > 0.0) & (scale <= 1.0 + 1e-12))
    assert np.all(found.reached == (scale > 1.0 - 1e-9))
    assert np.mean(found.reached) < 0.2
    assert_within(thrusters, found.u)


@pytest.mark.parametrize("method", METHODS)
def test_the_largest_share_is_found(method: Any) -> None:
    """A linear program of scipy's as oracle, where no thruster turns."""
    tau = 3.0 * reachable(BARGE, 60, 1.0)
    found = Allocation(method, BARGE).allocate(tau, PLANAR)
    T = Allocation("qp", BARGE).matrix(PLANAR)
    bounds = [(-astern(one), one.ahead_n) for one in BARGE]
    size = np.max(np.abs(T), axis=1)[:, None]
    for one, applied in zip(tau, found.applied, strict=True):
        equal = np.hstack([T / size, -one[:, None] / size])
        best = linprog(
            [0, 0, 0, 0, 0, -1], A_eq=equal, b_eq=np.zeros(3), bounds=[*bounds, (0, 1)]
        ).x[-1]
        assert (applied @ one) / (one @ one) == pytest.approx(best, rel=1e-6)


@given(st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3))
def test_the_pseudo_inverse_is_the_lightest_where_nothing_is_at_its_limit(way: list[float]) -> None:
    tau = np.array([way]) * [1e4, 1e4, 1e5]
    allocation = Allocation("pseudo_inverse", SHIP)
    T = allocation.matrix(PLANAR)
    found = allocation.allocate(tau, PLANAR)
    np.testing.assert_allclose(found.u[0], np.linalg.pinv(T) @ tau[0], atol=1e-6)


def test_a_heavy_weight_spares_a_thruster() -> None:
    tau = np.array([[0.0, 1e5, 0.0]])
    spared = (*SHIP[:3], replace(SHIP[3], weight=100.0), SHIP[4])
    for method in METHODS:
        even = Allocation(method, SHIP).allocate(tau, PLANAR).u[0]
        uneven = Allocation(method, spared).allocate(tau, PLANAR).u[0]
        assert abs(uneven[4]) < 0.2 * abs(even[4])


def test_the_others_take_over_what_a_thruster_at_its_limit_leaves() -> None:
    thrusters = (
        PositionedThruster("tunnel", (10.0, 0.0, 0.0), 1.0),
        PositionedThruster("tunnel", (10.0, 0.0, 0.0), 9.0),
        PositionedThruster("tunnel", (-10.0, 0.0, 0.0), 9.0),
        PositionedThruster("fixed", (0.0, 0.0, 0.0), 9.0),
    )
    found = Allocation("pseudo_inverse", thrusters).allocate(np.array([[0.0, 10.0, 0.0]]), PLANAR)
    np.testing.assert_allclose(found.u[0], [1.0, 4.0, 5.0, 0.0], atol=1e-9)
    assert found.reached[0]


def test_eight_thrusters_move_the_vehicle_every_way() -> None:
    allocation = composed("vessel=beluga_full", "excitation=prbs").vessel.thrusters
    T = allocation.matrix(DOFS)
    assert T.shape == (6, 8)
    tau = np.diag([60.0, 60.0, 80.0, 8.0, 10.0, 12.0])
    for method in METHODS:
        found = Allocation(method, allocation.thrusters).allocate(tau, DOFS)
        assert np.all(found.reached)
        np.testing.assert_allclose(found.u @ T.T, tau, atol=1e-9)


def test_a_lower_voltage_takes_from_the_force() -> None:
    """Hoyer (2021), section 4.2: 44.1 and 34.5 N at 14 V, 51.4 and 39.2 N at 16 V."""
    thrusters = composed("vessel=beluga_full", "excitation=prbs").vessel.thrusters.thrusters
    tau = np.array([[500.0, 0.0, 0.0, 0.0, 0.0, 0.0]])
    full, low = (
        Allocation("qp", thrusters, volts).allocate(tau, DOFS).applied[0, 0]
        for volts in (16.0, 14.0)
    )
    assert full == pytest.approx(4 * 51.4 * np.sqrt(0.5), rel=1e-6)
    assert low == pytest.approx(4 * 44.1 * np.sqrt(0.5), rel=1e-6)
    one = (PositionedThruster("tunnel", (0.0, 0.0, 0.0), 51.4, 39.2),)
    table = Allocation("qp", one, 14.0).table(("sway",))
    assert (table.low[0], table.high[0]) == pytest.approx((-34.5, 44.1))
    with pytest.raises(ConfigurationError, match="voltage_v"):
        Allocation("qp", thrusters, 12.0)


@pytest.mark.nightly
@pytest.mark.parametrize("method", METHODS)
def test_the_allocation_stands_between_controller_and_vessel(method: str) -> None:
    velocities = "excitation.velocities={surge: [0.3, 0.3]}"
    runs = "identifier=none", "excitation=constant_velocity", velocities
    by_method = *runs, f"vessel.thrusters.method={method}"
    free, shared = (sailed(composed(*words)).voyage.log for words in (runs, by_method))
    np.testing.assert_allclose(shared.eta, free.eta, atol=1e-9)  # it has force enough
    np.testing.assert_array_equal(free.applied, free.tau)
    assert np.all(reached(shared.tau, shared.applied))
    weak = [f"{{kind: azimuth, position_m: [{x}, 0, 0], ahead_n: 40.0}}" for x in (1.8, -1.8)]
    weaker = composed(*by_method, f"vessel.thrusters.thrusters=[{','.join(weak)}]")
    limited = sailed(weaker).voyage.log
    assert 0.0 < np.mean(reached(limited.tau, limited.applied)) < 1.0
    assert np.max(np.abs(limited.applied[:, 0])) <= 80.0 + 1e-6
    assert np.max(np.abs(limited.tau[:, 0])) > 80.0


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: replace(SHIP[0], ahead_n=0.0), "ahead_n"),
        (lambda: replace(SHIP[0], astern_n=-1.0), "astern_n"),
        (lambda: replace(SHIP[0], direction=(0.0, 0.0, 0.0)), "direction"),
        (lambda: replace(SHIP[0], weight=0.0), "weight"),
        (lambda: replace(SHIP[2], astern_n=1.0), "astern_n"),
        (lambda: Allocation("qp", ()), "thrusters: got none"),
        (lambda: Allocation("qp", SHIP[:2]).matrix(PLANAR), "2 independent directions"),
        (lambda: Allocation("none", SHIP).allocate(np.zeros((1, 3)), PLANAR), "method: got none"),
    ],
)
def test_wrong_options_are_refused(make: Any, message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        make()
