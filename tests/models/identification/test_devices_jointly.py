"""Parameters of devices, identified jointly with the table by free runs."""

from dataclasses import replace

import numpy as np
import pytest

from seatrial.models.errors import ConfigurationError
from seatrial.models.identification.free_parameters import free_parameters, with_devices
from seatrial.models.identification.predictor import PredictionOptions
from seatrial.models.identification.problem import Identified, Problem
from seatrial.models.identification.validation import prediction
from seatrial.models.recording.recording import Recording
from seatrial.models.vessel.devices.device import with_parameters
from seatrial.models.vessel.table import Vessel
from tests.models.identification.test_steered import NO_MISSION, mistaken, recorded, vessel
from tests.trials import composed

RUDDER = ("rudder.gamma_R_plus", "rudder.gamma_R_minus", "rudder.a_H", "rudder.epsilon")
PROPELLER = ("propeller.w_P0",)
HULL = ("sway.vU", "sway.rU", "yaw.vU", "yaw.rU")


def changed(model: Vessel, **factors: float) -> Vessel:
    """The model with parameters of devices multiplied, `rudder__a_H=1.2`."""
    devices = model.installed
    values = devices.parameters.copy()
    for name, factor in factors.items():
        values[devices.labels.index(name.replace("__", "."))] *= factor
    return replace(model, devices=with_parameters(model.devices, values.tolist()))


def value(model: Vessel, label: str) -> float:
    return float(model.installed.parameters[model.installed.labels.index(label)])


def option(name: str, *options: str) -> PredictionOptions:
    return composed("vessel=kvlcc2", *NO_MISSION, f"identifier={name}", *options).identifier


def joint(name: str, problem: Problem, *options: str) -> Identified:
    identifier = option(name, *options)
    identifier.check(problem.nominal, None, measured=False)
    return identifier.identify(problem, np.random.default_rng(0))


def free(*labels: str) -> str:
    return f"identifier.free={list(labels)}"


def parts(whole: Recording, nominal: Vessel) -> Problem:
    half = len(whole) // 2
    return Problem(whole.part(slice(0, half)), whole.part(slice(half, None)), nominal, None)


TRUTH = {
    "rudder__gamma_R_plus": 1.15, "rudder__gamma_R_minus": 0.9, "rudder__a_H": 1.2,
    "rudder__epsilon": 0.95, "propeller__w_P0": 1.1,
}  # fmt: skip


def test_rudder_and_propeller_are_found_with_the_hull() -> None:
    """Without noise and prior the joint fit is exact, and its free run is the motion."""
    nominal = vessel("kvlcc2")
    truth = changed(mistaken(nominal, ("vU", "rU")), **TRUTH)
    own = parts(recorded("kvlcc2", truth, 800), nominal)
    result = joint(
        "output_error", own, free(*HULL, *RUDDER, *PROPELLER), "identifier.prior=null",
        "identifier.horizon=100", "identifier.horizons=[30]",
    )  # fmt: skip
    for label in (*RUDDER, *PROPELLER):
        assert value(result.model, label) == pytest.approx(value(truth, label), rel=1e-5)
        assert value(nominal, label) != pytest.approx(value(truth, label), rel=1e-2)
        assert 0.0 < result.device_errors[label] < 1e-3
    for label in HULL:
        dof, _, term = label.partition(".")
        expected = truth.coefficient(dof, term)
        assert result.model.coefficient(dof, term) == pytest.approx(expected, rel=1e-5)
    predicted = prediction(result.model, own.validation, None).over("free_run")
    assert np.all(predicted.rmse[3:] < 1e-5)


def noisy(whole: Recording, seed: int, deviation: float) -> Recording:
    rng = np.random.default_rng(seed)
    size = deviation * np.std(whole.nu, axis=0)
    return replace(whole, nu=whole.nu + size * rng.standard_normal(whole.nu.shape))


def test_a_prior_weighs_as_an_observation() -> None:
    """A wide one changes nothing, a narrow one keeps the nominal value with its own error."""
    nominal = vessel("kvlcc2")
    truth = changed(nominal, rudder__a_H=1.2)
    own = parts(noisy(recorded("kvlcc2", truth, 800), 0, 0.05), nominal)
    given = (free("rudder.a_H", "yaw.rU"), "identifier.horizon=100", "identifier.horizons=[]")
    found = {
        deviation: joint(
            "output_error", own, *given, "identifier.prior=null",
            f"++identifier.deviations={{rudder.a_H: {deviation}}}",
        )
        for deviation in (100.0, 1e-6)
    }  # fmt: skip
    none = joint("output_error", own, *given, "identifier.prior=null")
    label = "rudder.a_H"
    assert value(found[100.0].model, label) == pytest.approx(value(none.model, label), rel=1e-4)
    assert found[100.0].device_errors[label] == pytest.approx(none.device_errors[label], rel=1e-3)
    assert value(found[1e-6].model, label) == pytest.approx(value(nominal, label), rel=1e-4)
    assert found[1e-6].device_errors[label] == pytest.approx(1e-6, rel=1e-2)


def test_the_whole_table_is_determined_with_the_default_prior() -> None:
    """Hull and all devices: what the recording does not tell keeps its nominal value."""
    nominal = vessel("kvlcc2")
    truth = changed(mistaken(nominal, ("vU", "rU")), **TRUTH)
    own = parts(noisy(recorded("kvlcc2", truth, 800), 0, 0.01), nominal)
    result = joint(
        "output_error", own, free("table", *RUDDER, *PROPELLER), "identifier.horizon=100",
        "identifier.horizons=[]",
    )  # fmt: skip
    before, after = (
        prediction(model, own.validation, None).over("free_run").rmse[3:]
        for model in (nominal, result.model)
    )
    assert np.all(after < 0.2 * before)
    assert value(result.model, "rudder.l_R") == value(nominal, "rudder.l_R")


def test_candidates_in_packs_have_their_own_devices() -> None:
    """Errors of many candidates at once are those of one at a time."""
    nominal = vessel("kvlcc2")
    own = parts(recorded("kvlcc2", nominal, 200), nominal)
    predictor = option("nsga2", free(*HULL, *RUDDER)).predictor(own)
    rng = np.random.default_rng(0)
    size = rng.uniform(0.8, 1.2, (40, len(predictor.free)))
    points = predictor.free.values * size
    errors, _, realistic = predictor.errors(points, "mse")
    assert np.all(realistic)
    single = [np.mean(np.square(predictor.mismatch(point)), axis=0) for point in points]
    np.testing.assert_allclose(errors, single, rtol=1e-9)
    assert np.std(errors[:, -1]) > 0.0


def test_the_search_finds_parameters_of_devices() -> None:
    nominal = vessel("kvlcc2")
    truth = changed(nominal, rudder__a_H=1.3, propeller__w_P0=1.15)
    own = parts(recorded("kvlcc2", truth, 600), nominal)
    result = joint(
        "nsga2", own, free("rudder.a_H", "propeller.w_P0"), "identifier.population=40",
        "identifier.generations=15", "identifier.polish=null", "identifier.decision=ideal",
    )  # fmt: skip
    assert value(result.model, "rudder.a_H") == pytest.approx(value(truth, "rudder.a_H"), rel=0.1)
    label = "propeller.w_P0"
    assert value(result.model, label) == pytest.approx(value(truth, label), rel=0.05)


def test_names_of_free_parameters() -> None:
    ship = vessel("kvlcc2")
    table = free_parameters(ship, [], "free", False)
    both = with_devices(table, ["rudder.gamma_R_*"])
    assert both.labels == ("rudder.gamma_R_plus", "rudder.gamma_R_minus")
    assert len(with_devices(table, ["rudder.*"])) == len(ship.devices["rudder"].PARAMETERS)
    added = option("output_error", free("table", "yaw.n^2", "rudder.neutral_rad")).unknowns(ship)
    assert added.labels[-2:] == ("yaw.n^2", "rudder.neutral_rad")
    assert added.units[-1] == "rad"
    with pytest.raises(ConfigurationError, match=r"identifier\.free: got 'rudder\.gamma'"):
        with_devices(table, ["rudder.gamma"])
    with pytest.raises(ConfigurationError, match="nothing to identify"):
        option("output_error", "identifier.free=[]").unknowns(ship)
    chosen = option("output_error", "++identifier.deviations={rudder.a_H: 0.1}")
    free_of_devices, short = chosen.unknowns(ship), recorded("kvlcc2", ship, 50)
    with pytest.raises(ConfigurationError, match=r"deviations\.rudder\.a_H: not a parameter"):
        chosen.prior_of(free_of_devices, short)


def test_bounds_of_devices_are_their_plausible_ranges() -> None:
    ship = vessel("kvlcc2")
    chosen = option("output_error", free("rudder.a_H", "rudder.neutral_rad"))
    lower, upper = chosen.box(chosen.unknowns(ship), recorded("kvlcc2", ship, 50))
    np.testing.assert_array_equal(lower, [-0.5, -0.2])
    np.testing.assert_array_equal(upper, [1.0, 0.2])
