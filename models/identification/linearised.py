"""The nominal model linearised about one velocity.

Nothing is identified: the model is the tangent of the nominal one, sampled with a zero-order hold,

    x_{k+1} = A x_k + B (tau_k + F_w,k),    y_k = [I 0] x_k,    x = (pose in body axes, nu)

with the force F_w of the measured wind as a known input. Its free run over the held-out part
compares a linear with a nonlinear model: Bargouth (2022), sections 3.2, 4.2 and 4.3.
"""

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from seatrial.models.errors import ConfigurationError, IdentificationError
from seatrial.models.findings import Finding
from seatrial.models.identification.problem import (
    Identified,
    Identifier,
    Needs,
    Problem,
    check_force,
    check_forces,
)
from seatrial.models.identification.sampled_data import Sampled, sampled, stretches
from seatrial.models.identification.state_space_findings import fit, model_findings
from seatrial.models.notation import PLANAR, POSE_UNIT
from seatrial.models.ranges import Positive, check_ranges
from seatrial.models.recording.recording import Recording
from seatrial.models.simulation.linearisation import linearise, operating_force, tangent
from seatrial.models.simulation.statespace import StateSpace
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import AIR, N_VARIABLES, VARIABLES, Array
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
    force: str | None
    hold_s: Positive | None

    def __post_init__(self) -> None:
        check_ranges(self)
        check_force(self.force)

    def check(self, nominal: Vessel, thruster: SecondOrderLag | None, measured: bool) -> None:
        """Raise ConfigurationError for a velocity that the vessel does not have."""
        check_forces("linearised", nominal)
        unknown = [dof for dof in self.velocity or {} if dof not in nominal.dofs]
        if unknown:
            raise ConfigurationError(
                f"identifier.velocity: got {unknown[0]}, but {nominal.name} moves in "
                f"{', '.join(nominal.dofs)}"
            )

    def needs(self) -> Needs:
        """The force of the input."""
        return Needs(self.force, thruster_lag=self.force == "filtered")

    def identify(self, problem: Problem, rng: np.random.Generator) -> Identified:
        """The linear table and its sampled state-space model, with the errors of its free run.

        Raises IdentificationError when `hold_s` exceeds the held-out part.
        """
        nominal, held_out = problem.nominal, problem.validation
        velocity = np.array([(self.velocity or {}).get(dof, 0.0) for dof in nominal.dofs])
        table = tangent(nominal, velocity, self.operating_force)
        windy = nominal.dofs == PLANAR and held_out.wind is not None
        if self.wind is not None and windy and not nominal.force_table().aerodynamic:
            table = table + self.wind.table(nominal.dofs)
        motion, still = parted(table)
        data = sampled(held_out, self.force, still.terms, "body_pose", self.hold_s, np.inf)
        model = replace(sampled_model(motion, still, data.period_s), outputs=data.outputs)
        findings = (
            *order_findings(model),
            *model_findings(model, 0, nominal.dofs),
            *free_run_findings(model, data, held_out),
        )
        table = replace(table, name="identified")
        return Identified(table, table - nominal, findings=findings, state_space=model)


def parted(table: Vessel) -> tuple[Vessel, Vessel]:
    """Split a table into the linear motion and the known inputs, wind and constant forces.

    The restoring force is linearised about zero attitude; its value there is a constant force.
    """
    known = [
        term.name == "1" or bool({VARIABLES[c % N_VARIABLES] for c in term.codes} & set(AIR))
        for term in table.terms
    ]

    def part(flag: bool) -> Vessel:
        rows = [i for i, is_known in enumerate(known) if is_known == flag]
        terms = tuple(table.terms[i] for i in rows)
        return Vessel(table.name, table.dofs, terms, table.theta[rows])

    motion, inputs = part(False), part(True)
    n = len(table.dofs)
    level = operating_force(motion, np.zeros(n), np.zeros(3), np.zeros(2))
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


def order_findings(model: StateSpace) -> list[Finding]:
    """Orders and stability, Bargouth (2022), section 4.3."""
    values: dict[str, float] = {
        "spectral_radius": model.spectral_radius,
        "controllable_order": model.controllable_order,
        "observable_order": model.observable_order,
        "eigenvalues_at_one": int(np.sum(np.abs(model.eigenvalues - 1.0) < ONE)),
    }
    return [Finding(name, "all", value) for name, value in values.items()]


def free_run_findings(model: StateSpace, held_out: Sampled, recording: Recording) -> list[Finding]:
    """Fit [%] and root mean square error of a free run from the measured state, and the drift.

    The drift is the distance travelled at the end, in body axes: |y_N - y_0|.
    """
    if not len(held_out.y):
        raise IdentificationError(
            f"identifier.hold_s: got {held_out.period_s:g} s, expected at most the "
            f"{len(recording)} samples that are held out"
        )
    first = np.flatnonzero(recording.piece_starts)
    first = first[np.unique(held_out.stretch)]
    free, drift = [], np.zeros(len(recording.dofs))
    ys, us = (stretches(values, held_out.stretch) for values in (held_out.y, held_out.u))
    for start, y, u in zip(first, ys, us, strict=True):
        with np.errstate(over="ignore", invalid="ignore"):  # an unstable model may diverge
            free.append(model.simulate(u, np.concatenate([y[0], recording.nu[start]])))
        drift = np.maximum(drift, np.abs(y[-1] - y[0]))
    return _residual_findings(held_out.y, np.vstack(free), drift, recording.dofs)


def _residual_findings(y: Array, free: Array, drift: Array, dofs: tuple[str, ...]) -> list[Finding]:
    units = [POSE_UNIT[dof] for dof in dofs]
    with np.errstate(over="ignore", invalid="ignore"):
        rmse = np.sqrt(np.mean(np.square(y - free), axis=0))
    return [
        Finding(name, dof, float(value), unit)
        for name, values, value_units in (
            ("fit_free_run", fit(y, free), ["%"] * len(dofs)),
            ("body_pose_rmse_free_run", rmse, units),
            ("body_drift", drift, units),
        )
        for dof, value, unit in zip(dofs, values, value_units, strict=True)
    ]
