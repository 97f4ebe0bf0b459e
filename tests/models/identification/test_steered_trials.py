"""Simulated manoeuvring trials with noise: what turning circle the identified models predict.

The truth is KVLCC2 by the method of MMG. The believed coefficients are off by up to 20 %, so that
the believed turning circle is too. The trials are those of IMO resolution MSC.137(76), turning
circles to both sides and zig-zags of 10 and 20 degrees.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from seatrial.models.identification.free_run import course_of, free_run
from seatrial.models.identification.problem import Problem
from seatrial.models.recording.recording import Recording
from seatrial.models.simulation.manoeuvre_measures import Track, turn
from seatrial.models.vessel import basis
from seatrial.models.vessel.devices.device import with_parameters
from seatrial.models.vessel.manoeuvring import manoeuvring_basis
from seatrial.models.vessel.steady_speed import steady_speed
from seatrial.models.vessel.table import Vessel
from seatrial.runner.closed_loop import Streams
from seatrial.runner.trial import excite
from tests.models.identification.test_steered import identified, vessel
from tests.trials import asked_for

SHAFT = 11.85  # [1/s]
LENGTH_M = 7.0
ZIGZAGS = ((20, "zigzag"), (-20, "zigzag"), (10, "zigzag"), (-10, "zigzag"))
CIRCLES = ((35, "turn"), (-35, "turn"))
UNSURE = ("epsilon", "kappa", "gamma_R_plus", "gamma_R_minus", "l_R", "t_R", "a_H", "x_H",
          "w_P0", "t_P")  # fmt: skip
FREE = ["table", *(f"rudder.{name}" for name in UNSURE[:-2]), "propeller.w_P0", "propeller.t_P"]


class Circle(NamedTuple):
    """Measures in ship lengths."""

    tactical_diameter: float
    advance: float


def trials(seed: int, kinds: tuple[tuple[int, str], ...]) -> Recording:
    """The recordings of several trials with noise, one after the other with gaps between them."""
    parts, begin = [], 0.0
    for i, (helm_deg, kind) in enumerate(kinds):
        trial = asked_for(
            "vessel=kvlcc2", f"excitation=rudder_{kind}", f"excitation.helm_deg={helm_deg}",
            f"excitation.turn_deg={abs(helm_deg)}", "excitation.duration_s=150",
            "excitation.approach_s=5", "identifier=none", "controller=none", "evaluation=none",
            "disturbance=noise",
        )  # fmt: skip
        recording = excite(trial, Streams(1000 * seed + i)).recording
        parts.append(replace(recording, t=recording.t - recording.t[0] + begin))
        begin = float(parts[-1].t[-1]) + 1.0
    joined = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in ("t", "eta", "nu", "nu_dot", "tau", "attitude", "inputs", "commands")
    }
    return replace(parts[0], tau_actual=None, tau_filtered=None, **joined)


def circle(model: Vessel, helm_deg: float) -> Circle:
    """A turning circle that the model predicts, from its steady speed."""
    t = 0.1 * np.arange(1500)
    helm = np.radians(helm_deg) * np.clip((t - 5.0) * 0.276 / np.radians(35.0), 0.0, 1.0)
    nothing = np.zeros((len(t), 3))
    nu = nothing.copy()
    nu[:, 0] = steady_speed(model, np.array([0.0, SHAFT]), 5.0)
    inputs = np.column_stack([helm, np.full(len(t), SHAFT)])
    still = Recording(
        model.dofs, t, nothing, nu, nothing, nothing, nothing, inputs=inputs,
        input_names=model.inputs,
    )  # fmt: skip
    x, y, psi, u, v, _ = free_run(model, course_of(still, None, None, None, np.inf), "rk4").T
    found = turn(Track(t, x, y, psi, helm, np.hypot(u, v), LENGTH_M))
    return Circle(found.tactical_diameter, found.advance)


def believed_ship(truth: Vessel, share: float) -> Vessel:
    """Hull, rudder and propeller coefficients off by up to a share."""
    rng = np.random.default_rng(5)
    theta = np.array(truth.theta)
    for i, term in enumerate(truth.terms):
        if "U" in term.name:
            theta[i] *= rng.uniform(1.0 - share, 1.0 + share, 3)
    installed = truth.installed
    unsure = np.array([label.partition(".")[2] in UNSURE for label in installed.labels])
    factors = np.where(unsure, rng.uniform(1.0 - share, 1.0 + share, len(unsure)), 1.0)
    values = (installed.parameters * factors).tolist()
    return replace(truth, theta=theta, devices=with_parameters(truth.devices, values))


def polynomial(ship: Vessel) -> Vessel:
    """A table without devices that approximates the forces of a ship over its manoeuvres."""
    terms = manoeuvring_basis(ship.accelerations, ("delta",))[len(ship.dofs) :]
    rng = np.random.default_rng(0)
    low, high = np.array([[0.4, -0.3, -0.1, -0.62], [1.25, 0.3, 0.1, 0.62]])
    states = rng.uniform(low, high, (4000, 4))
    nu, inputs = states[:, :3], np.column_stack([states[:, 3], np.full(len(states), SHAFT)])
    x = ship.variables(np.zeros_like(nu), nu, inputs=inputs)
    force = ship.inverse(np.zeros_like(nu), nu, inputs=inputs)
    theta = np.linalg.lstsq(basis.evaluate(terms, x), force, rcond=None)[0]
    rows = basis.terms(ship.accelerations) + terms
    return replace(ship, terms=rows, theta=np.vstack([ship.inertia.T, theta]), devices={})


def errors(model: Vessel, truth: Vessel) -> np.ndarray:
    """Relative errors of the tactical diameter to both sides."""
    pairs = [(circle(model, helm), circle(truth, helm)) for helm in (35.0, -35.0)]
    return np.array([own.tactical_diameter / true.tactical_diameter - 1.0 for own, true in pairs])


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_abkowitz_by_instruments_turns_as_the_ship(seed: int) -> None:
    """Tactical diameter within 2 % of the truth, where what is believed misses it by 7 to 19 %."""
    truth = vessel("kvlcc2")
    recording, believed = trials(seed, ZIGZAGS + CIRCLES), polynomial(believed_ship(truth, 0.2))
    assert np.max(np.abs(errors(believed, truth))) > 0.1
    result = identified(
        "iv", Problem(recording, recording, believed, None), "identifier.iterations=4",
        "identifier.orientation_terms=false",
    )  # fmt: skip
    assert np.max(np.abs(errors(result.model, truth))) < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_mmg_by_joint_least_squares_turns_as_the_ship(seed: int) -> None:
    """From zig-zags alone: no turning circle is among the trials."""
    truth = vessel("kvlcc2")
    recording, believed = trials(seed, ZIGZAGS), believed_ship(truth, 0.2)
    assert np.max(np.abs(errors(believed, truth))) > 0.05
    result = identified(
        "least_squares", Problem(recording, recording, believed, None), "identifier.horizons=[]",
        "identifier.horizon=250", f"identifier.free={FREE}",
    )  # fmt: skip
    assert np.max(np.abs(errors(result.model, truth))) < 0.02
