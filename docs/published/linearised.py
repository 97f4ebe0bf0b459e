"""The nominal model linearised about one velocity.

Nothing is identified: the model is the tangent of the nominal one, sampled with a zero-order hold,

    x_{k+1} = A x_k + B (tau_k + F_w,k),    y_k = [I 0] x_k,    x = (pose in body axes, nu)

with the force F_w of the measured wind as a known input. Its free run over the held-out part
compares a linear with a nonlinear model: Bargouth (2022), sections 3.2, 4.2 and 4.3.
"""

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from seatrial.models import notation
from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError
from seatrial.models.identification.dsr import Sampled, fit, forces_of, model_diagnostics, sampled
from seatrial.models.identification.problem import (
    Force,
    Identified,
    Identifier,
    Needs,
    Problem,
    check_forces,
)
from seatrial.models.notation import PLANAR, POSE_UNIT, poses_of
from seatrial.models.ranges import Positive, check_ranges
from seatrial.models.recording.recording import Recording
from seatrial.models.simulation.linearisation import gradient, linearise, operating_force
from seatrial.models.simulation.statespace import StateSpace
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import AIR, INDEX, N_VARIABLES, Array
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag
from seatrial.models.vessel.tuning import FromVessel
from seatrial.models.weather.wind import WindForce

ONE = 5e-4  # an eigenvalue this near to 1 is printed as 1.000


@dataclass(frozen=True)
class Linearised(Identifier):
    """The tangent of the nominal model at `velocity` [m/s, rad/s], by degree of freedom.

    `operating_force: false` uses the derivatives only and omits the force at that velocity, as in
    Bargouth (2022), (3.27)-(3.28). `wind` is the wind force on the vessel, used if the wind is
    measured. `hold_s` [s] is the period of the model (null: that of the recording).
    """

    velocity: dict[str, float] | None
    operating_force: bool
    wind: Annotated[WindForce | None, FromVessel("tuning.windage")]
    force: Force | None
    hold_s: Positive | None

    def __post_init__(self) -> None:
        check_ranges(self)

    def check(self, nominal: Vessel, thruster: SecondOrderLag | None, measured: bool) -> None:
        """Raise ConfigurationError for a velocity that the vessel does not have."""
        check_forces("linearised", nominal)
        if unknown := set(self.velocity or {}) - set(nominal.dofs):
            raise ConfigurationError(
                f"identifier.velocity: got {min(unknown)}, but {nominal.name} moves in "
                f"{', '.join(nominal.dofs)}"
            )

    def needs(self) -> Needs:
        """The force of the input."""
        return Needs(self.force, thruster_lag=self.force == "filtered")

    def identify(self, problem: Problem, rng: np.random.Generator) -> Identified:
        """The linear table and its sampled state-space model, with the errors of its free run."""
        nominal, held_out = problem.nominal, problem.validation
        velocity = np.array([(self.velocity or {}).get(dof, 0.0) for dof in nominal.dofs])
        table = tangent(nominal, velocity, self.operating_force)
        windy = nominal.dofs == PLANAR and held_out.wind is not None
        if self.wind is not None and windy and not nominal.force_table().aerodynamic:
            table = table + self.wind.table(nominal.dofs)
        motion, still = parted(table)
        inputs = (*forces_of(nominal.dofs), *(term.name for term in still.terms))
        data = sampled(held_out, self.force, inputs, poses_of(nominal.dofs), self.hold_s)
        model = replace(sampled_model(motion, still, data.period_s), outputs=data.outputs)
        orders = {
            "spectral_radius": model.spectral_radius,
            "controllable_order": model.controllable_order,
            "observable_order": model.observable_order,
            "eigenvalues_at_one": int(np.sum(np.abs(model.eigenvalues - 1.0) < ONE)),
        }  # Bargouth (2022), section 4.3
        found = (
            *(Diagnostic(name, "all", float(value)) for name, value in orders.items()),
            *model_diagnostics(model, 0),
            *free_run_errors(model, data, held_out),
        )
        table = replace(table, name="identified")
        return Identified(table, table - nominal, diagnostics=found, state_space=model)


def tangent(vessel: Vessel, nu: Array, offset: bool = True) -> Vessel:
    """The table linearised in the body velocity: F(nu_0) + dF/dnu (nu - nu_0).

    Terms with a velocity are replaced by u, v, ... and, with `offset`, by the constant of the
    tangent; the attitude in them is level and north. `nu` (n_dof,) [m/s, rad/s] is the operating
    point. Terms without a velocity, and those in the velocity through the air, are unchanged.
    """
    moving, aerodynamic = _have(vessel, notation.VELOCITIES), _have(vessel, AIR)
    terms = tuple(vessel.terms[i] for i in np.flatnonzero(moving & ~aerodynamic))
    constant = tuple(term for term in vessel.terms if term not in terms)
    x = vessel.variables(np.zeros((1, len(nu))), nu[None, :])
    theta = vessel.on(terms).theta
    columns = [INDEX[name] for name in vessel.velocities]
    slope = gradient(basis.codes(terms), x[0])[:, columns].T @ theta
    rest = basis.evaluate(terms, x) @ theta - nu @ slope
    names = [*vessel.velocities, *(["1"] if offset and np.any(rest != 0.0) else [])]
    linear = np.vstack([slope, rest])[: len(names)]
    return vessel.on(constant) + Vessel(vessel.name, vessel.dofs, basis.terms(names), linear)


def _have(vessel: Vessel, variables: tuple[str, ...]) -> np.ndarray:
    """Whether each term of a table has one of the variables, shape (n_terms,)."""
    codes = basis.codes(vessel.terms) % N_VARIABLES
    return np.any(np.isin(codes, [INDEX[name] for name in variables]), axis=1)


def parted(table: Vessel) -> tuple[Vessel, Vessel]:
    """Split a table into the linear motion and the known inputs, wind and constant forces.

    The restoring force is linearised about zero attitude; its value there is a constant force.
    """
    known = _have(table, AIR) | np.array([term.name == "1" for term in table.terms])
    motion, inputs = (
        Vessel(
            table.name, table.dofs,
            tuple(table.terms[i] for i in np.flatnonzero(rows)), table.theta[rows],
        )
        for rows in (~known, known)
    )  # fmt: skip
    level = operating_force(motion, np.zeros(len(table.dofs)), np.zeros(3), np.zeros(2))
    if np.any(level != 0.0):
        inputs = inputs + Vessel("level", table.dofs, basis.terms(["1"]), level[None, :])
    return motion, inputs


def sampled_model(motion: Vessel, still: Vessel, period_s: float) -> StateSpace:
    """The zero-order hold of the motion about rest, inputs (tau, terms of `still`)."""
    model = linearise(motion)
    B = np.hstack([model.B, -model.B @ still.theta.T])
    D = np.zeros((len(model.C), B.shape[1]))
    inputs = (*model.inputs, *(term.name for term in still.terms))
    return replace(model, B=B, D=D, inputs=inputs).discretised(period_s)


def free_run_errors(model: StateSpace, held_out: Sampled, recording: Recording) -> list[Diagnostic]:
    """Fit [%] and root mean square error of a free run from the measured state, and the drift.

    The drift is the distance travelled at the end, in body axes: |y_N - y_0|.
    """
    first = np.flatnonzero(recording.piece_starts)[np.unique(held_out.stretch)]
    edges = np.flatnonzero(np.diff(held_out.stretch)) + 1
    stretches = zip(*(np.split(each, edges) for each in (held_out.y, held_out.u)), strict=True)
    free, drift = [], np.zeros(len(recording.dofs))
    with np.errstate(over="ignore", invalid="ignore"):  # an unstable model may diverge
        for start, (y, u) in zip(first, stretches, strict=True):
            free.append(model.simulate(u, np.concatenate([y[0], recording.nu[start]])))
            drift = np.maximum(drift, np.abs(y[-1] - y[0]))
        rmse = np.sqrt(np.mean(np.square(held_out.y - np.vstack(free)), axis=0))
    units = [POSE_UNIT[dof] for dof in recording.dofs]
    quantities = {
        "fit_free_run": (fit(held_out.y, np.vstack(free)), ["%"] * len(units)),
        "body_pose_rmse_free_run": (rmse, units),
        "body_drift": (drift, units),
    }
    return [
        Diagnostic(name, dof, float(value), unit)
        for name, (values, value_units) in quantities.items()
        for dof, value, unit in zip(recording.dofs, values, value_units, strict=True)
    ]
