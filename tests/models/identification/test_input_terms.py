"""Which terms of its inputs a vessel has beside its devices, and that they find what these lack."""

import numpy as np
import pytest

from seatrial.models.identification.robust import input_labels
from seatrial.models.vessel import basis
from tests.models.conftest import configured

LABELS = {
    "kvlcc2": {"surge.|n|n", "surge.u|n|", "sway.n^2delta", "yaw.u|n|delta", "surge.n^2delta^2"},
    "blueboat": {"surge.pwm_1", "yaw.|pwm_2|pwm_2", "yaw.upwm_1"},
    "otter": {"surge.n_1^2", "yaw.|n_2|n_2", "surge.un_2"},
}


@pytest.mark.parametrize("name", LABELS)
def test_a_vessel_with_devices_has_terms_of_its_inputs(name: str) -> None:
    nominal = configured("vessel", name).nominal()
    labels = input_labels(nominal, windy=False)
    assert LABELS[name] <= set(labels)
    assert len(set(labels)) == len(labels)
    for label in labels:
        dof, _, term = label.partition(".")
        assert dof in nominal.dofs
        names = {basis.VARIABLES[code % basis.N_VARIABLES] for code in basis.term(term).codes}
        assert names & set(nominal.inputs)
    more = set(input_labels(nominal, windy=True)) - set(labels)
    lateral = (f"{dof}.{term}" for dof in ("sway", "yaw") for term in ("V_qv_q", "u_qv_q"))
    assert more == {"surge.V_qu_q", *lateral}


def test_a_thruster_acts_where_it_pushes() -> None:
    """Two thrusters that push ahead turn the boat, and do not move it aside."""
    labels = input_labels(configured("vessel", "blueboat").nominal(), windy=False)
    assert not [label for label in labels if label.startswith("sway")]


@pytest.mark.parametrize("name", ["milliampere", "milliampere_azimuths", "mariner"])
def test_others_have_none(name: str) -> None:
    """Commanded forces, thrusters that turn, and tables without devices."""
    assert input_labels(configured("vessel", name).nominal(), windy=True) == []


def test_they_find_a_thrust_that_the_propeller_lacks() -> None:
    """Each label is a column of its own in the regression: its effect is not that of another."""
    nominal = configured("vessel", "kvlcc2").nominal()
    rng = np.random.default_rng(0)
    x = np.zeros((500, basis.N_VARIABLES))
    for name in ("u", "v", "r", "n", "delta"):
        x[:, basis.INDEX[name]] = rng.standard_normal(500)
    x[:, 0] = 1.0
    for dof in nominal.dofs:
        start = f"{dof}."
        labels = [label for label in input_labels(nominal, windy=False) if label.startswith(start)]
        own = [label.removeprefix(start) for label in labels]
        phi = basis.evaluate(basis.terms(own), x)
        assert np.linalg.matrix_rank(phi / np.linalg.norm(phi, axis=0), tol=1e-6) == len(own)
