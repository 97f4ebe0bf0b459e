"""Instrumental variables: outside data, the ferry, and consistency where least squares fails."""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from seatrial.models.errors import IdentificationError
from seatrial.models.excitation.commands import Piece, command
from seatrial.models.excitation.setpoints import UNFILTERED
from seatrial.models.identification import instrumental_variables as iv
from seatrial.models.identification.instrumental_variables import simulated_motion, solve
from seatrial.models.identification.problem import Problem
from seatrial.models.simulation.loop import sail
from seatrial.models.simulation.registry import Timetable
from seatrial.models.simulation.voyage import recording_of
from seatrial.models.vessel import basis
from seatrial.models.vessel.parameters import Plant
from seatrial.models.vessel.table import Vessel
from seatrial.models.weather.current import Current
from seatrial.models.weather.disturbance import Disturbance
from seatrial.models.weather.noise import MeasurementNoise, ProcessNoise, first_order
from seatrial.models.weather.wind import Wind
from tests.data import DATA
from tests.models.conftest import configured

# The pure estimator


@pytest.mark.data
def test_two_stage_least_squares_of_griliches() -> None:
    """Log wage on schooling and IQ, both endogenous: Stata's and statsmodels' numbers."""
    table = np.genfromtxt(DATA / "iv" / "griliches76.csv", delimiter=",", names=True)
    years = [1.0 * (table["year"] == year) for year in np.unique(table["year"])[1:]]
    controls = [table[name] for name in ("expr", "tenure", "rns", "smsa")]
    exogenous = [*controls, *years, np.ones(len(table))]
    phi = np.column_stack([table["s"], table["iq"], *exogenous])
    z = np.column_stack([*(table[name] for name in ("med", "kww", "age", "mrt")), *exogenous])
    found = solve(z, phi, table["lw"][:, None])
    assert found.theta[0, 0] == pytest.approx(0.172425, abs=1e-6)
    assert found.theta[1, 0] == pytest.approx(-0.009099, abs=1e-6)


def simultaneous(n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Two regressors that share noise with the target, and three instruments that do not."""
    z, noise = rng.standard_normal((n, 3)), rng.standard_normal(n)
    phi = z @ np.array([[1.0, 0.2], [0.0, 1.0], [0.5, 0.5]]) + 0.8 * noise[:, None]
    return z, phi, (phi @ [2.0, -1.0] + noise)[:, None]


def test_as_many_instruments_as_terms_solve_the_moment_equations() -> None:
    z, phi, y = simultaneous(500, np.random.default_rng(1))
    found = solve(z[:, :2], phi, y)
    np.testing.assert_allclose(z[:, :2].T @ (y - phi @ found.theta), 0.0, atol=1e-9)
    gains = z[:, :2] @ (found.inverse @ found.share)
    np.testing.assert_allclose(gains.T @ y, found.theta, atol=1e-12)


def test_instruments_that_do_not_determine_are_refused() -> None:
    z, phi, y = simultaneous(100, np.random.default_rng(3))
    with pytest.raises(IdentificationError, match="got 1 instruments for 2 terms"):
        solve(z[:, :1], phi, y)
    with pytest.raises(IdentificationError, match="do not distinguish a, b from each other"):
        solve(z[:, [0, 0]], phi, y, ("a", "b"))


# Recordings of the ferry and of the basin


@pytest.mark.parametrize("options", [{}, {"restart_s": None}, {"instruments": "none"}])
@pytest.mark.parametrize("disturbance", ["calm", "constant"])
def test_noise_free_recordings_are_explained_exactly(
    lap, estimator, rng, disturbance, options
) -> None:
    sailed = lap(disturbance)
    found = estimator("iv", **options).identify(sailed.problem, rng)
    truth = sailed.truth.on(found.residual.terms).theta
    model = found.model.on(found.residual.terms).theta
    real = truth != 0.0
    np.testing.assert_allclose(model[real], truth[real], rtol=1e-6)


def test_noisy_accelerations_do_not_bias_the_inertia(lap, estimator, rng) -> None:
    sailed = lap("noise", 0)
    error = {}
    for instruments in ("none", "simulated"):
        found = estimator("iv", instruments=instruments).identify(sailed.problem, rng)
        ratio = np.diag(found.model.inertia) / np.diag(sailed.truth.inertia)
        error[instruments] = np.max(np.abs(ratio - 1.0))
    assert error["none"] > 0.05
    assert error["simulated"] < 0.02


def test_a_mean_force_without_its_columns_is_refused(constant, estimator, rng) -> None:
    with pytest.raises(IdentificationError, match="orientation_terms=true"):
        estimator("iv", orientation_terms=False, restart_s=None).identify(constant.problem, rng)


def surge(**options: Any) -> Any:
    """Inertia and damping from the measured surge-1, the author's window."""
    vessel = configured("vessel", "surge_linear")
    file = configured(
        "excitation", "recording", path=f"{DATA}/beluga/surge-1.csv", start_s=410.0, end_s=650.0
    )
    recording = file.read(vessel.dofs)
    split = file.split(recording.t)
    problem = Problem(
        recording.part(split.train), recording.part(split.test), vessel.nominal(), None
    )
    iv = configured("identifier", "iv", **{"lowpass_hz": None, "inertia_factor": None, **options})
    iv.check(vessel.nominal(), None, True)
    return iv.identify(problem, np.random.default_rng(0))


@pytest.mark.data
def test_measured_surge() -> None:
    """Differentiated velocities are noisy: least squares finds a fifth of the inertia.

    The outside figure, of a fit to positions, is (140.4, 98.3); to velocities (168.0, 67.7).
    """
    found, filtered = surge(), surge(lowpass_hz=0.5)
    error = float(np.asarray(found.std_error)[0, 0])
    assert 5.0 < error < 12.0
    assert found.model.inertia[0, 0] == pytest.approx(140.4, abs=2.0 * error)
    assert found.model.inertia[0, 0] == pytest.approx(filtered.model.inertia[0, 0], rel=0.03)
    assert surge(instruments="none").model.inertia[0, 0] < 50.0


# Weak instruments


def test_instruments_of_the_true_model_are_the_true_motion(calm) -> None:
    training = calm.problem.training
    motion, first, _ = simulated_motion(training, [calm.truth], "filtered", None)
    np.testing.assert_allclose(motion.nu, training.nu, atol=1e-3)
    assert np.flatnonzero(first).tolist() == [0]


def test_a_model_that_diverges_is_refined_or_refused(
    estimator, calm, rng, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers = iter([False, True, False, False])
    monkeypatch.setattr(iv.InstrumentalVariables, "_simulates", lambda *_: next(answers))
    found = estimator("iv").identify(calm.problem, rng)
    assert found.warnings == (iv.REFINED,)
    with pytest.raises(IdentificationError, match=r"instruments are too weak.* diverges under"):
        estimator("iv").identify(calm.problem, rng)
    assert next(answers, None) is None


def test_a_model_of_weak_instruments_is_refined_or_has_no_intervals(
    estimator, calm, rng, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(iv, "WEAK", np.inf)
    constrained = estimator("iv", inertia_factor=5.0)
    refined = constrained.identify(calm.problem, rng)
    assert refined.warnings == (iv.REFINED,)
    assert refined.std_error is not None
    regression = estimator("iv").identify(calm.problem, rng)  # as it is, weak or not
    assert regression.warnings == ()
    assert regression.std_error is not None
    answers = iter([False, True])
    monkeypatch.setattr(iv.InstrumentalVariables, "_simulates", lambda *_: next(answers))
    kept = constrained.identify(calm.problem, rng)
    assert (kept.warnings, kept.std_error, kept.spread) == ((iv.NO_INTERVALS,), None, None)


def test_instruments_that_say_little_of_the_motion_are_weak() -> None:
    rng = np.random.default_rng(1)
    phi = rng.normal(size=(4000, 3))
    own, other = phi + 0.5 * rng.normal(size=phi.shape), rng.normal(size=phi.shape)
    lack = rng.normal(size=(4000, 1))

    def strength(z: np.ndarray) -> float:
        return solve(z, phi, lack).strength

    # Explained over left is one over 0.25, the variance of what the instruments have of their own.
    assert strength(own) == pytest.approx(4000 / 3 / 0.25, rel=0.15)
    assert strength(other) < 2.0  # an F of nothing is about 1, the least of three is less
    assert strength(np.column_stack([own[:, :2], other[:, 2]])) < 5.0  # one bad one suffices


def test_the_strength_of_one_regressor_is_the_f_of_its_first_stage() -> None:
    z, noise, lack = np.random.default_rng(2).normal(size=(3, 30, 8))
    phi, y = z[:, :1] + noise[:, :1], lack[:, :1]
    (rest,) = np.linalg.lstsq(z, phi, rcond=None)[1]
    assert solve(z, phi, y).strength == pytest.approx((np.sum(phi**2) / rest - 1.0) * (30 - 8) / 8)


# Consistency: a ship in wind and current, all velocities measured with noise

PERIOD_S = 0.5
OFFSET = np.array([0.4, 0.3, 0.3])  # velocities about which the ship is excited [m/s, rad/s]
SPREAD = np.array([0.11, 0.085, 0.085])
TERMS = ("u_dot", "v_dot", "r_dot", "uv", "ur", "vr", "u", "|u|u", "v", "|v|v", "r", "|r|r")
# While velocities keep their signs these are the same columns; wind forces go to the quadratic
LUMPED = {"r^2": "|r|r", "|v|r": "vr", "|u_q|u_q": "|u|u", "|v_q|v_q": "|v|v"}
PREDICTORS = {"1": (False, False), "2": (True, False), "3": (True, True)}
SLOW_WIND, FAST_WIND = 0.2, 2.0  # [m/s]; the ship makes 0.1 to 0.7


@dataclass(frozen=True)
class Experiment:
    """The modulus ship of conf/vessel, under a force that was worked out for an offset motion."""

    wind_m_s: float

    def disturbance(self) -> Disturbance:
        wind = Wind(
            ship().tuning.windage, self.wind_m_s, None, 60.0, "to", "gusting", 60.0, 0.15, 5.0,
            10.0, None,
        )  # fmt: skip
        return Disturbance(
            noise=MeasurementNoise(0.01, 0.2, 0.05, 1.5, 0.005, 0.2, 0.1),
            wind=wind,
            current=Current(0.03, -30.0, "constant", 0.0, 600.0, 1.0),
            process=ProcessNoise((0.002, 0.002, 0.002), "normal"),
        )

    def run(self, n: int, seed: int) -> tuple[Problem, np.ndarray]:
        """A recording of n samples with a nominal model 20 % off, and the effective parameters."""
        rng, vessel, disturbance = np.random.default_rng(seed), ship(), self.disturbance()
        force = offset_force(vessel.nominal(), n, rng)
        weather = disturbance.realise(n, vessel.dofs, rng, rng, PERIOD_S)
        truth = vessel.nominal() + disturbance.aerodynamics(vessel.dofs)
        voyage = sail(
            Plant(truth, None, vessel.velocity_limits), weather,
            (Timetable(np.zeros((n, 3))), np.zeros(1)), UNFILTERED,
            command([Piece()], np.zeros(3), 0, 0), np.zeros(3),
            PERIOD_S, 0.1, OFFSET, added=force,
        )  # fmt: skip
        recording = recording_of(voyage, weather)
        wanted = effective(truth)
        assumed = wanted * rng.uniform(0.8, 1.2, wanted.shape)
        nominal = Vessel("nominal", vessel.dofs, basis.terms(TERMS), assumed)
        return Problem(recording, recording, nominal, None), wanted


@cache
def ship() -> Any:
    return configured("vessel", "modulus_ship")


def offset_force(model: Vessel, n: int, rng: np.random.Generator) -> np.ndarray:
    """The force of a smooth random motion about the offset, (n, 3)."""
    keep = np.exp(-PERIOD_S / 1.0)
    nu = np.empty((n, 3))
    for i in range(3):
        level = lfilter([1 - keep], [1, -keep], first_order(n, PERIOD_S, 1.0, 3.0, rng))
        nu[:, i] = OFFSET[i] + SPREAD[i] * np.clip(level / np.std(level), -2.2, 2.2)
    return model.inverse(np.gradient(nu, PERIOD_S, axis=0), nu)


def effective(model: Vessel) -> np.ndarray:
    """Coefficients over TERMS, shape (n_terms, 3), what is lumped added."""
    rows = {name: model.row(name).copy() for name in TERMS}
    for name, into in LUMPED.items():
        rows[into] += model.row(name)
    return np.array([rows[name] for name in TERMS])


def predictor(name: str) -> Any:
    """LS1 to LS3 and IV1 to IV3: one simulation, as restarts let measured noise into it."""
    orientation, wind = PREDICTORS[name[-1]]
    return configured(
        "identifier", "iv", basis=list(TERMS), iterations=1, orientation_terms=orientation,
        wind_measurement=wind, instruments="none" if name.startswith("LS") else "simulated",
        lowpass_hz=None, inertia_factor=None, restart_s=None,
    )  # fmt: skip


def median_errors(
    experiment: Experiment, names: tuple[str, ...], sizes: tuple[int, int], runs: int
) -> dict[str, np.ndarray]:
    """Median norm of the error of the effective parameters [SI], by predictor, (n_sizes,)."""
    identifiers = {name: predictor(name) for name in names}
    errors: dict[str, list[list[float]]] = {name: [] for name in names}
    for n in sizes:
        found: dict[str, list[float]] = {name: [] for name in names}
        for seed in range(runs):
            problem, wanted = experiment.run(n, seed)
            for name, one in identifiers.items():
                residual = one.estimate(problem, None)[1].residual(problem.nominal.dofs)
                wrong = effective(problem.nominal + residual) - wanted
                found[name].append(float(np.linalg.norm(wrong)))
        for name in names:
            errors[name].append(np.median(found[name]).item())
    return {name: np.array(values) for name, values in errors.items()}


@pytest.mark.parametrize(("wind", "name"), [(SLOW_WIND, "IV2"), (FAST_WIND, "IV3")])
@pytest.mark.parametrize(
    ("n", "runs", "biased", "gain"),
    [
        (16_000, 5, ("LS3",), 2.0),
        pytest.param(128_000, 50, ("LS1", "LS2", "LS3"), 6.0,
                     marks=[pytest.mark.nightly, pytest.mark.timeout(7200)]),
    ],
)  # fmt: skip
def test_instruments_are_consistent_where_least_squares_is_not(
    wind: float, name: str, n: int, runs: int, biased: tuple[str, ...], gain: float
) -> None:
    """Against 2,000 samples the instruments' error falls with N, that of least squares not."""
    errors = median_errors(Experiment(wind), (name, *biased), (2000, n), runs)
    assert errors[name][0] / errors[name][1] >= gain
    for least_squares in biased:
        assert errors[least_squares][1] == pytest.approx(errors[least_squares][0], rel=0.15)


@pytest.mark.nightly
def test_standard_errors_of_a_recording_are_the_spread() -> None:
    """Over 40 recordings within a factor of 2, and 1.96 of them cover about 95 % of the errors."""
    options = {"basis": list(TERMS), "iterations": 1, "inertia_factor": None}
    iv = configured("identifier", "iv", **options)
    wrong, reported = [], []
    for seed in range(40):
        problem, wanted = Experiment(SLOW_WIND).run(8000, seed)
        found = iv.identify(problem, np.random.default_rng(0))
        wrong.append(effective(found.model) - wanted)
        reported.append(np.asarray(found.std_error)[: len(TERMS)])
    ratio = np.median(reported, axis=0) / np.std(wrong, axis=0)
    assert np.all((ratio > 0.5) & (ratio < 2.0))
    assert 0.92 < np.mean(np.abs(np.array(wrong) / reported) < 1.96) < 0.995
