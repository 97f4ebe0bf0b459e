"""Estimates from dimensions: against published vessels, similarity, and what cannot be."""

import numpy as np
import pytest

from docs.vessels import parameters_of
from seatrial.models.errors import ConfigurationError
from seatrial.models.identification.physical_constraints import dissipated
from seatrial.models.vessel.scales import WATER, Hull, derivatives, hull, model, rigid_body
from tests.models.vessel.oracles import constants

# Length, beam, draught [m] and mass [kg] as published, and the factors within which inertia and
# drag in surge, sway and yaw agree. The supply vessel's draught is that of a block of 0.65.
PUBLISHED = {
    "supply_fossen": ((76.2, 18.0, 6.57, 6.0e6), 1.25, 5.0),
    "cybership2": ((1.255, 0.29, None, 23.8), 2.1, 5.0),
}
CRUISE = np.diag([0.15, 0.07, 0.1])  # in units of sqrt(g L) and sqrt(g / L)


@pytest.mark.parametrize("name", PUBLISHED)
def test_they_are_near_published_vessels(name: str) -> None:
    dimensions, inertia, drag = PUBLISHED[name]
    estimated, published = model(hull(*dimensions)), parameters_of(name).nominal()
    ratio = np.diag(estimated.inertia) / np.diag(published.inertia)
    assert np.all((ratio > 1.0 / inertia) & (ratio < inertia)), ratio
    length = dimensions[0]
    nu = CRUISE * np.sqrt(9.81 * length) / np.array([1.0, 1.0, length])
    still = np.zeros((3, 3))
    ratio = np.diag(estimated.inverse(still, nu)) / np.diag(published.inverse(still, nu))
    assert np.all((ratio > 1.0 / drag) & (ratio < drag)), ratio


@pytest.mark.data
def test_added_mass_is_near_that_of_mss() -> None:
    """X_udot of its Otter is by the same formula; those of its supply ship are integrals."""
    values, ship = constants("mss_otter_coeffs.json"), constants("mss_osv_coeffs.json")["vessel"]
    catamaran = hull(values["L"], values["B"], values["T"], values["m"])
    assert derivatives(catamaran)["X_udot"] == pytest.approx(values["Xudot"], rel=1e-12)
    found = derivatives(hull(ship["L"], ship["B"], ship["T"], ship["m"]))
    expected = -np.diag(ship["MA"])[[0, 1, 5]]
    ratio = np.array([found[name] for name in ("X_udot", "Y_vdot", "N_rdot")]) / expected
    assert np.all((ratio > 0.8) & (ratio < 1.8)), ratio


def test_a_model_at_another_scale_is_similar_by_froudes_law() -> None:
    """Masses scale with L^3, times with sqrt(L), and so do the dimensions of a coefficient."""
    powers = {
        "X_udot": 3.0, "Y_vdot": 3.0, "N_rdot": 5.0, "X_u": 2.5, "X_|u|u": 2.0, "Y_v": 2.5,
        "Y_|v|v": 2.0, "N_r": 4.5, "N_|r|r": 5.0,
    }  # fmt: skip
    small = derivatives(Hull(2.0, 0.5, 0.2, 90.0))
    large = derivatives(Hull(20.0, 5.0, 2.0, 90.0e3))
    for name, power in powers.items():
        assert large[name] == pytest.approx(10.0**power * small[name], rel=1e-12), name
    assert set(powers) == set(small)


def test_what_is_not_given_follows_from_archimedes() -> None:
    floating = hull(10.0, mass_kg=12_000.0)
    block = floating.mass_kg / (WATER * floating.length_m * floating.beam_m * floating.draught_m)
    assert block == pytest.approx(0.6)
    drawn = hull(10.0, beam_m=floating.beam_m, draught_m=floating.draught_m)
    assert drawn.mass_kg == pytest.approx(12_000.0)
    assert rigid_body(drawn)["I_z"] == pytest.approx(12_000.0 * 2.5**2)


@pytest.mark.parametrize("length", [0.1, 1.0, 12.0, 1000.0])
def test_every_hull_has_energy_and_loses_it(length: float) -> None:
    table = model(hull(length))
    assert np.min(np.linalg.eigvalsh(table.inertia)) > 0.0
    nu = np.random.default_rng(0).uniform(-1.0, 1.0, (1000, 3)) * np.sqrt(length)
    assert np.min(dissipated(table, nu)) > 0.0


@pytest.mark.parametrize(
    ("dimensions", "message"),
    [
        ((0.01,), "length_m must be at least 0.1, got 0.01"),
        ((5.0, 6.0), "beam: got 6 m, expected 0.025 to 5 m for a length of 5 m"),
        ((5.0, 2.0, 0.001), "draught: got 0.001 m, expected 0.025 to 5 m for a length of 5 m"),
        ((5.0, 2.0, 1.0, 1e5), "mass: got 100000 kg, expected 0.02 to 1 times the 1.025e.04 kg of"),
        ((5.0, 2.0, None, 1e9), "mass: got 1e.09 kg, expected 153.8 to 3.075e.04 kg for this leng"),
    ],
)
def test_a_hull_that_cannot_be(dimensions: tuple[float, ...], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        hull(*dimensions)
