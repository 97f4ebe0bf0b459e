"""Identification from recorded inputs: rudder angle and shaft speed instead of forces."""

from dataclasses import replace

import numpy as np
import pytest

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.excitation.information import persistence
from seatrial.models.identification.cross_validation import CrossValidation
from seatrial.models.identification.free_parameters import nonzero_labels, own_coriolis
from seatrial.models.identification.free_run import course_of, free_run
from seatrial.models.identification.problem import Identified, Problem, choose_basis
from seatrial.models.identification.validation import prediction
from seatrial.models.recording.recording import Recording, attitude_of
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import Array, each_product_once
from seatrial.models.vessel.derivatives import coriolis
from seatrial.models.vessel.table import Vessel
from tests.trials import composed

NO_MISSION = ("excitation=rudder_turn", "identifier=none", "controller=none", "evaluation=none")
PERIOD_S = {"mariner": 1.0, "kvlcc2": 0.2}
WRONG = ("uv", "ur", "u^2delta", "v^3/U", "v^2r/U", "v^2delta", "u^2delta^3")


def vessel(name: str) -> Vessel:
    return composed(f"vessel={name}", *NO_MISSION).vessel.nominal()


def steered(model: Vessel, helm: Array, speed_m_s: float, period_s: float, *rest: float
            ) -> Recording:  # fmt: skip
    """The motion under rudder angles [rad] that are linear between samples, without noise."""
    n, dofs = len(helm), model.dofs
    nothing = np.zeros((n, len(dofs)))
    nu = np.tile(np.where(np.array(dofs) == "surge", speed_m_s, 0.0), (n, 1))
    inputs = np.column_stack([helm, *(np.full(n, value) for value in rest)])
    still = Recording(
        dofs, period_s * np.arange(n), nothing, nu, nothing, nothing, np.zeros((n, 3)),
        inputs=inputs, input_names=model.inputs,
    )  # fmt: skip
    motion = free_run(model, course_of(still, None, None, None, np.inf), "rk4")
    eta, nu = motion[:, : len(dofs)], motion[:, len(dofs) :]
    attitude = attitude_of(dofs, eta)
    nu_dot = model.forward(np.zeros_like(nu), nu, attitude, inputs=inputs)
    return replace(still, eta=eta, nu=nu, nu_dot=nu_dot, attitude=attitude)


def helm(n: int, period_s: float, seed: int) -> Array:
    """Rudder angles of different size to both sides [rad], with a finite rate."""
    rng = np.random.default_rng(seed)
    hold = round(40.0 * period_s / PERIOD_S["mariner"] / period_s)
    steps = np.radians(rng.uniform(-30.0, 30.0, n // hold + 1)).repeat(hold)[:n]
    return np.convolve(np.pad(steps, (10, 0)), np.full(11, 1.0 / 11.0), "valid")


def recorded(name: str, model: Vessel, n: int = 2400, seed: int = 1) -> Recording:
    period = PERIOD_S[name]
    speed, rest = (7.7175, ()) if name == "mariner" else (1.17, (11.85,))
    return steered(model, helm(n, period, seed), speed, period, *rest)


def problem(name: str, truth: Vessel, nominal: Vessel) -> Problem:
    whole = recorded(name, truth)
    half = len(whole) // 2
    training, rest = whole.part(slice(0, half)), whole.part(slice(half, None))
    return Problem(training, rest, nominal, None)


def mistaken(truth: Vessel, terms: tuple[str, ...]) -> Vessel:
    """The model with some of its coefficients off by 10 to 30 % of what they do together."""
    rng = np.random.default_rng(3)
    table = Vessel("error", truth.dofs, basis.terms(terms), np.zeros((len(terms), len(truth.dofs))))
    theta = np.array(table.theta)
    for i, term in enumerate(table.terms):
        theta[i] = truth.row(term.name) * rng.uniform(0.1, 0.3, len(truth.dofs))
    return truth + replace(table, theta=theta)


def listed(terms: tuple[str, ...]) -> str:
    """The option of a basis."""
    return f"identifier.basis={list(terms)}"


def identified(name: str, problem: Problem, *options: str) -> Identified:
    trial = composed(
        "vessel=mariner", "excitation=rudder_turn", "controller=none", "evaluation=none",
        f"identifier={name}", *options,
    )  # fmt: skip
    trial.identifier.check(problem.nominal, None, measured=False)
    return trial.identifier.identify(problem, np.random.default_rng(0))


def close_to(truth: Vessel, model: Vessel, tolerance: float) -> None:
    """Compare what every coefficient of a model is, relative to the largest of its term."""
    table = model.on(truth.terms).theta
    size = np.max(np.abs(truth.theta), axis=1, keepdims=True)
    size[size == 0.0] = np.max(size)
    assert np.max(np.abs(table - truth.theta) / size) < tolerance


@pytest.mark.parametrize("identifier", ["ls", "iv", "ridge", "robust"])
def test_the_mariner_is_found_from_its_rudder(identifier: str) -> None:
    """Without noise the regression is exact, and so is the free run of what it finds.

    The prior of `robust` keeps a part of the error.
    """
    truth = vessel("mariner")
    own = problem("mariner", truth, mistaken(truth, WRONG))
    options = {
        "iv": ("identifier.orientation_terms=false",),
        "ridge": ("identifier.penalty=0.0", "identifier.tune=null"),
        "robust": ("identifier.disturbance=none",),
    }.get(identifier, ())
    result = identified(identifier, own, listed(WRONG), "identifier.lowpass_hz=null", *options)
    close_to(truth, result.model, 1e-2 if identifier == "robust" else 1e-6)
    before, after = (
        prediction(model, own.validation, None).over("free_run").rmse
        for model in (own.nominal, result.model)
    )
    assert np.all(after < (1e-2 if identifier == "robust" else 1e-6) * before)


def test_a_table_of_manoeuvring_terms_is_found_whole() -> None:
    """All terms of `basis: full`, of a model that has them."""
    ship = vessel("mariner")
    terms = choose_basis("full", (), ship)
    x = recorded("mariner", ship).variables()
    inertial = ship.inertia
    force = -x[:, [basis.INDEX[name] for name in ship.accelerations]] @ inertial.T
    fitted, *_ = np.linalg.lstsq(basis.evaluate(terms, x), force, rcond=1e-10)
    rows = basis.terms(ship.accelerations)
    truth = replace(ship, terms=rows + terms, theta=np.vstack([inertial.T, fitted]))
    nominal = replace(truth, theta=np.vstack([inertial.T, 0.8 * fitted]))
    own = problem("mariner", truth, nominal)
    result = identified("ls", own, "identifier.lowpass_hz=null")
    predicted = prediction(result.model, own.validation, None).over("free_run")
    assert not predicted.diverged
    assert np.all(predicted.rmse < 1e-6 * np.std(own.validation.nu, axis=0).max())


def test_the_hull_behind_known_devices_is_found_with_its_inertia() -> None:
    """Rudder and propeller give forces in newton, so that the added mass follows too."""
    truth = vessel("kvlcc2")
    terms = ("u_dot", "v_dot", "r_dot", "vU", "rU", "v^3/U", "v^2r/U", "U^2")
    own = problem("kvlcc2", truth, mistaken(truth, terms))
    result = identified("ls", own, listed(terms), "identifier.lowpass_hz=null")
    close_to(truth, result.model, 1e-6)


def test_inputs_give_coefficients_relative_to_the_inertia() -> None:
    """Twice the table under the same rudder moves in the same way."""
    ship = vessel("mariner")
    once, twice = recorded("mariner", ship, 300), recorded("mariner", 2.0 * ship, 300)
    np.testing.assert_allclose(twice.nu, once.nu, rtol=1e-9, atol=1e-12)
    own = problem("mariner", ship, ship)
    with pytest.raises(ConfigurationError, match="relative to the inertia only"):
        identified("ls", own, "identifier.basis=[r_dot,uv,ur]")
    labels = [label for label, _ in nonzero_labels(ship, "tied")]
    assert not any("_dot" in label for label in labels)
    assert "surge.u_dot" in dict(nonzero_labels(vessel("kvlcc2"), "tied"))


def test_a_product_with_many_powers_of_speed_is_written_with_few() -> None:
    straight = ["U^2", "uU", "1/U", "u"]
    rudder, hull = ["U^2delta", "Udelta", "udelta"], ["vU", "uv", "v"]
    few = ["r_dot", "v^3/U", "v^2r", "v^2r/U", "U^2delta^3"]
    given = basis.terms([*straight, *rudder, *hull, *few])
    names = [term.name for term in each_product_once(given)]
    expected = ["1", "u", "u^2", "delta", "udelta", "uv", *few]
    assert names == [term.name for term in basis.terms(expected)]
    assert each_product_once(each_product_once(given)) == each_product_once(given)


def test_mmg_has_coriolis_forces_without_the_munk_moment() -> None:
    ship = vessel("kvlcc2")
    own, full = own_coriolis(ship), coriolis(ship.inertia, ship.dofs)
    assert own.coefficient("yaw", "uv") == 0.0
    assert full.coefficient("yaw", "uv") != 0.0
    assert own.coefficient("sway", "ur") == full.coefficient("sway", "ur") != 0.0


def test_excitation_is_judged_with_the_terms_of_the_inputs() -> None:
    ship = vessel("mariner")
    steady = steered(ship, np.zeros(300), 7.7175, 1.0)
    turned = persistence(recorded("mariner", ship), ship)
    for before, after in zip(persistence(steady, ship), turned, strict=True):
        rudder = {term for term in before.terms if "delta" in term}
        assert rudder
        assert rudder <= {*before.unexcited}
        assert not after.unexcited
        assert after.lines > 0
        assert after.rank >= before.rank + len(rudder)


def test_free_runs_over_blocks_know_the_inputs() -> None:
    """The true model has no error on the blocks; a wrong one has."""
    truth = vessel("kvlcc2")
    wrong = mistaken(truth, ("vU", "rU"))
    right, off = (
        CrossValidation(problem("kvlcc2", truth, model)).nominal for model in (truth, wrong)
    )
    assert right.error < 1e-12
    assert off.error > 1e-4


def test_inputs_that_are_missing_are_one_line() -> None:
    ship = vessel("kvlcc2")
    whole = recorded("kvlcc2", ship, 100)
    without = replace(whole, input_names=("n", "delta"))
    with pytest.raises(RecordingError, match="got inputs n, delta, expected those of kvlcc2"):
        Problem(without, without, ship, None)


@pytest.mark.parametrize("name", ["tanker", "container", "remus100", "osv", "frigate"])
def test_every_steered_vessel_has_the_bases(name: str) -> None:
    """Written with the speed, a product of the tanker has six factors, u|beta||delta|beta n^2."""
    ship = vessel(name)
    for choice in ("physical", "full", "linear"):
        terms = choose_basis(choice, (), ship)
        assert len(terms) > 1
        assert len({*terms}) == len(terms)
