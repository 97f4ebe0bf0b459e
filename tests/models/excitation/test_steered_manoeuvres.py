"""Manoeuvres of steered vessels: laws of stable and unstable ships, limits, and other signs."""

from functools import cache

import numpy as np
import pytest

from seatrial.models.errors import ConfigurationError
from seatrial.models.excitation.helm import register
from seatrial.models.simulation.manoeuvre_sheet import (
    Track,
    reverse_spiral,
    sheet,
    spiral,
    steady_states,
    williamson,
)
from seatrial.models.simulation.voyage import Voyage
from seatrial.models.vessel.steering import steering_model
from tests.models.vessel.test_steered import steered, track, vessel

LENGTH = {"kvlcc2": 7.0, "mariner": 160.93}
COARSE = ("integration_step_s=0.5", "sample_time_s=0.5")  # for the long manoeuvres of the mariner


@cache
def voyage(name: str, excitation: str, *options: str) -> Voyage:
    return steered(f"vessel={name}", f"excitation={excitation}", *options)


def motion_of(name: str, excitation: str, *options: str) -> Track:
    return track(voyage(name, excitation, *options), LENGTH[name])


def growth(name: str) -> float:
    """The largest real part of the eigenvalues of sway and yaw, ahead."""
    ship = vessel(name)
    model = steering_model(ship.nominal(), ship.approach_speed_m_s, np.array(ship.input_start))
    return float(np.max(np.linalg.eigvals(model.A[1:, 1:]).real))


def test_a_straight_stable_ship_has_no_loop() -> None:
    """The mariner's eigenvalues are stable; its bias at helm 0 is that of its Y_0 and N_0."""
    assert growth("mariner") < 0.0
    motion = motion_of("mariner", "spiral", *COARSE)
    assert spiral(motion)["width of the loop"] == pytest.approx(0.0, abs=0.05)
    rate = np.degrees(steady_states(motion, motion.helm)[1])
    half = len(rate) // 2
    np.testing.assert_allclose(rate[:half], rate[half + 1 :][::-1], atol=1e-3)


def test_kvlcc2_is_unstable_and_has_a_loop() -> None:
    """An unstable eigenvalue; both spirals show the loop, and a residual rate of one size."""
    assert growth("kvlcc2") > 0.0
    direct = spiral(motion_of("kvlcc2", "spiral"))
    reverse = reverse_spiral(motion_of("kvlcc2", "reverse_spiral"))
    assert direct["width of the loop"] > 0.1
    assert reverse["width of the loop"] > 0.1
    residual = reverse["residual yaw rate"]
    assert direct["residual yaw rate"] == pytest.approx(residual, rel=0.05)


def test_both_spirals_have_the_same_stable_branches() -> None:
    """The helm that holds a rate is the helm that gives it."""
    direct, reverse = motion_of("kvlcc2", "spiral"), motion_of("kvlcc2", "reverse_spiral")
    helm, rate = np.degrees(steady_states(direct, direct.helm))
    yaw_rate = np.gradient(reverse.psi, reverse.t)
    helm_held, rate_held = np.degrees(steady_states(reverse, yaw_rate))
    order = np.argsort(rate_held)
    held = np.interp(rate, rate_held[order], helm_held[order])
    for side in (-1.0, 1.0):
        branch = (side * helm >= 5.0) & (side * helm <= 15.0)
        assert np.count_nonzero(branch) >= 6
        np.testing.assert_allclose(held[branch], helm[branch], atol=0.15)


def test_measures_before_a_pull_out_are_those_of_the_turn_without_one() -> None:
    plain = sheet(motion_of("kvlcc2", "rudder_turn")).values
    out = sheet(motion_of("kvlcc2", "rudder_pull_out")).values
    assert "residual yaw rate" not in plain
    for quantity in plain.keys() & out.keys():
        assert out[quantity] == pytest.approx(plain[quantity], rel=1e-3), quantity


@pytest.mark.parametrize("helm", [35, -35])
def test_a_williamson_turn_comes_back_on_its_track(helm: int) -> None:
    """Within two ship lengths of the track and one degree of the reciprocal course."""
    found = williamson(motion_of("kvlcc2", "williamson", f"excitation.helm_deg={helm}"))
    assert abs(found["error of the heading"]) < 1.0
    assert abs(found["offset from the track"]) < 2.0
    assert 2.0 < found["largest distance from the track"] < 8.0


def test_the_angle_of_a_williamson_turn_is_the_ships_own() -> None:
    """The offset rises with the angle of the first helm and passes through zero."""
    offsets = []
    for angle in (10, 40, 70, 100):
        turned = motion_of("mariner", "williamson", f"excitation.away_deg={angle}", *COARSE)
        found = williamson(turned)
        assert abs(found["error of the heading"]) < 2.0
        offsets.append(found["offset from the track"])
    assert np.all(np.diff(offsets) != 0.0)
    assert len(set(np.sign(np.diff(offsets)))) == 1
    assert offsets[0] * offsets[-1] < 0.0


@pytest.mark.parametrize("helm", [10, -10])
def test_a_zigzag_of_a_ship_whose_helm_has_the_other_sign(helm: int) -> None:
    """A positive helm turns the mariner to port; overshoots as in MSS, mariner_measures."""
    options = f"excitation.helm_deg={helm}", "excitation.duration_s=400"
    headings = np.degrees(motion_of("mariner", "rudder_zigzag", *options).psi)
    assert np.min(headings) < -10.0 and np.max(headings) > 10.0  # noqa: PT018
    first = int(np.argmax(np.abs(headings) > 5.0))
    assert np.sign(headings[first]) == -np.sign(helm)


def test_a_modified_zigzag_changes_sides_at_one_degree() -> None:
    values = sheet(motion_of("kvlcc2", "rudder_modified_zigzag")).values
    assert values["change of heading"] == 1.0
    assert values["helm"] == pytest.approx(5.0)


def test_a_binary_sequence_has_the_spectrum_of_its_law() -> None:
    """The circular autocorrelation of +-1 is n at lag 0 and -1 at all others."""
    signs = 1.0 - 2.0 * register(6)
    n = len(signs)
    correlation = np.array([signs @ np.roll(signs, k) for k in range(n)])
    assert n == 63
    assert correlation[0] == n
    np.testing.assert_array_equal(correlation[1:], -1.0)
    orders = voyage("kvlcc2", "rudder_prbs").log.tau[:, 0]
    assert set(np.round(np.degrees(orders), 9)) == {-10.0, 10.0}


def test_a_crash_stop_without_data_astern_offers_what_can_be_sailed() -> None:
    with pytest.raises(ConfigurationError, match=r"got -11\.85 for n, .* from 0 to 20") as caught:
        voyage("kvlcc2", "crash_stop")
    offered = str(caught.value).partition("; ")[2].partition(" is within")[0]
    assert offered == "excitation.values=[0.0]"
    orders = voyage("kvlcc2", "crash_stop", offered).log.tau[:, 1]
    assert orders[-1] == 0.0


def test_an_input_that_does_not_turn_the_vessel_steers_no_course() -> None:
    """Its orders in turn can be sailed all the same."""
    for excitation in ("williamson", "reverse_spiral"):
        with pytest.raises(ConfigurationError, match="got n, which gives no steady turn"):
            voyage("kvlcc2", excitation, "excitation.helm=n")
    assert len(voyage("kvlcc2", "input_prbs", "excitation.helm=n", "excitation.bits=2").t) > 0


def test_a_helm_that_the_vessel_lacks_is_answered_with_one_that_turns_it() -> None:
    for name, helm in (("remus100", "delta_r"), ("otter", "n_1")):
        with pytest.raises(ConfigurationError, match=f"; excitation.helm={helm} turns it"):
            voyage(name, "rudder_zigzag")
