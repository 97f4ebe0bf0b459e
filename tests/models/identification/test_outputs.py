"""Weighted outputs of an output-error fit, thrust among them."""

from dataclasses import replace

import numpy as np
import pytest

from seatrial.models.identification.predictor import weighted_outputs
from seatrial.models.identification.problem import Problem
from seatrial.models.recording.recording import Recording
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel
from tests.models.identification.test_devices_jointly import changed, free, joint, value
from tests.models.identification.test_steered import recorded, vessel

WEIGHTS = {"psi": 0.3, "u": 1.0, "v": 1.0, "r": 1.0, "propeller.thrust": 0.3}
OUTPUTS = "identifier.outputs={psi: 0.3, u: 1.0, v: 1.0, r: 1.0, propeller.thrust: 0.3}"


def thrust(model: Vessel, recording: Recording) -> Array:
    """T = rho n^2 D^4 K_T(J), Yasukawa and Yoshimura (2015), eqs. (9) and (10), (N,)."""
    p = model.devices["propeller"]
    n, (u, v, r) = recording.inputs[:, 1], recording.nu.T
    beta = -np.arctan2(v, u) - p.x_P * r * p.length_m / np.hypot(u, v)
    w = p.w_P0 * np.exp(-p.C_1 * beta**2)
    J = u * (1.0 - w) / (n * p.diameter_m)
    return p.rho_kg_m3 * n**2 * p.diameter_m**4 * (p.k_0 + p.k_1 * J + p.k_2 * J**2)


def with_thrust(model: Vessel, recording: Recording) -> Recording:
    loads = thrust(model, recording)[:, None]
    return replace(recording, loads=loads, load_names=("propeller.thrust",))


def test_the_thrust_of_a_propeller() -> None:
    ship = vessel("kvlcc2")
    recording = recorded("kvlcc2", ship, 200)
    loads = ship.devices["propeller"].loads(recording.variables())
    np.testing.assert_allclose(loads[:, 0], thrust(ship, recording), rtol=1e-12)


def test_thrust_tells_the_wake_from_the_thrust_deduction() -> None:
    """Both scale the force on the hull; only with the thrust measured are both found."""
    nominal = vessel("kvlcc2")
    truth = changed(nominal, propeller__w_P0=0.9, propeller__t_P=1.2)
    recording = with_thrust(truth, recorded("kvlcc2", truth, 600))
    own = Problem(recording, recording, nominal, None)
    labels = free("propeller.w_P0", "propeller.t_P")
    common = (labels, OUTPUTS, "identifier.prior=null", "identifier.horizon=100")
    result = joint("output_error", own, *common, "identifier.horizons=[]")
    for label in ("propeller.w_P0", "propeller.t_P"):
        assert value(result.model, label) == pytest.approx(value(truth, label), rel=1e-6)
    names = {f.label for f in result.diagnostics if f.name == "prediction_rms"}
    assert names == set(WEIGHTS)


def test_every_file_and_output_counts_alike() -> None:
    """An output in another unit, or a file of smaller motion, has errors of the same size."""
    ship = vessel("kvlcc2")
    recording = with_thrust(ship, recorded("kvlcc2", ship, 400))
    file = np.repeat([0, 1], 200)
    halves = np.where(file[:, None] == 0, 1.0, 1e-3)
    calm = replace(recording, nu=recording.nu * halves, file=file, file_names=("a", "b"))
    outputs = weighted_outputs(WEIGHTS, calm, ship)
    assert outputs.names == ("psi", "u", "v", "r", "propeller.thrust")
    deviation = np.hstack([calm.eta, calm.nu])[:, outputs.columns]
    errors = outputs.with_loads(deviation, recording.nu, ship.devices) / outputs.scale
    for part in (errors[:200], errors[200:]):
        np.testing.assert_allclose(np.std(part[:, 1:4], axis=0), 1.0, rtol=1e-9)
        assert np.std(part[:, 0]) == pytest.approx(0.3, rel=1e-9)
    np.testing.assert_allclose(errors[:, 4], 0.0, atol=1e-9)
