"""Weighted outputs of an output-error fit, thrust among them, and its bootstrap over files."""

from dataclasses import replace

import numpy as np
import pytest

from seatrial.models.errors import ConfigurationError, IdentificationError
from seatrial.models.identification.output_error import file_bootstrap
from seatrial.models.identification.prediction_fit import Fit
from seatrial.models.identification.predictor import outputs_of
from seatrial.models.identification.problem import Problem
from seatrial.models.recording.recording import Recording
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.devices.propeller import Propeller
from seatrial.models.vessel.table import Vessel
from tests.models.identification.test_devices_jointly import changed, free, joint, option, value
from tests.models.identification.test_steered import recorded, vessel

WEIGHTS = {"psi": 0.3, "u": 1.0, "v": 1.0, "r": 1.0, "propeller.thrust": 0.3}
OUTPUTS = "identifier.outputs={psi: 0.3, u: 1.0, v: 1.0, r: 1.0, propeller.thrust: 0.3}"


def thrust(model: Vessel, recording: Recording) -> Array:
    """T = rho n^2 D^4 K_T(J), Yasukawa and Yoshimura (2015), eqs. (9) and (10), (N,)."""
    p = model.devices["propeller"]
    assert isinstance(p, Propeller)
    assert recording.inputs is not None
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
    outputs = outputs_of(WEIGHTS, calm, ship)
    assert outputs.names == ("psi", "u", "v", "r", "propeller.thrust")
    deviation = np.hstack([calm.eta, calm.nu])
    errors = outputs.errors(deviation, recording.nu, ship.devices) / outputs.scale
    for part in (errors[:200], errors[200:]):
        np.testing.assert_allclose(np.std(part[:, 1:4], axis=0), 1.0, rtol=1e-9)
        assert np.std(part[:, 0]) == pytest.approx(0.3, rel=1e-9)
    np.testing.assert_allclose(errors[:, 4], 0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("outputs", "message"),
    [
        ("{w: 1.0, u: 1.0}", r"outputs: got w, expected some of x, y, psi, u, v, r, propeller\.th"),
        ("{u: 0.0}", r"outputs\.u must be positive, got 0"),
        ("{propeller.thrust: 1.0}", "outputs: got no state"),
    ],
)
def test_outputs_that_are_refused(outputs: str, message: str) -> None:
    identifier = option("output_error", f"identifier.outputs={outputs}")
    with pytest.raises(ConfigurationError, match=message):
        identifier.check(vessel("kvlcc2"), None, measured=False)


def linear(rng: np.random.Generator, files: int, prior: float) -> tuple[Fit, Array, Array]:
    """The fit of a linear model to several files, its regressors (N, 2, m) and file (N,)."""
    file = np.repeat(np.arange(files), 30)
    J = rng.standard_normal((len(file), 2, 3))
    y = np.einsum("nkm,m->nk", J, [1.0, -2.0, 0.5]) + 0.3 * rng.standard_normal((len(file), 2))
    flat, precision = J.reshape(-1, 3), np.full(3, prior)
    p = np.linalg.solve(flat.T @ flat + np.diag(precision), flat.T @ y.ravel())
    rest = y - np.einsum("nkm,m->nk", J, p)
    fit = Fit(p, np.zeros((0, 0)), flat, rest, np.ones(2), 1, precision, 1.0)
    return fit, y, file


@pytest.mark.parametrize("prior", [0.0, 50.0])
def test_a_replicate_of_a_linear_model_is_the_fit_of_the_drawn_files(prior: float) -> None:
    fit, y, file = linear(np.random.default_rng(0), 5, prior)
    box = np.full(3, -np.inf), np.full(3, np.inf)
    points = file_bootstrap(fit, np.zeros(3), box, file, 20, np.random.default_rng(4))
    rng = np.random.default_rng(4)
    J = fit.jacobian.reshape(-1, 2, 3)
    for point in points:
        weight = np.repeat(rng.multinomial(5, np.full(5, 0.2))[file], 2)
        flat = J.reshape(-1, 3) * weight[:, None]
        normal = flat.T @ J.reshape(-1, 3) + np.diag(fit.precision)
        np.testing.assert_allclose(point, np.linalg.solve(normal, flat.T @ y.ravel()), rtol=1e-9)


def test_a_bootstrap_over_files_needs_files() -> None:
    fit, _, file = linear(np.random.default_rng(0), 2, 0.0)
    box = np.full(3, -np.inf), np.full(3, np.inf)
    with pytest.raises(IdentificationError, match="got 2 files to train on, expected at least 3"):
        file_bootstrap(fit, np.zeros(3), box, file, 20, np.random.default_rng(0))
