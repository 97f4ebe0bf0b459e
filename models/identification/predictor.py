"""A fit by prediction: what is free, within which bounds, and how its predictions are made."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.models.identification.free_parameters import Coriolis, FreeParameters, free_parameters
from seatrial.models.identification.lanes import METRICS
from seatrial.models.identification.population import prediction_errors
from seatrial.models.identification.prediction import Course, course_of, predict
from seatrial.models.identification.problem import Identifier, Needs, Problem, check_force
from seatrial.models.identification.structure import Flags, Integrator, Layout, layout
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import PLANAR, Vessel, poses_of, velocities_of

POSE_UNIT = {"x": "m", "y": "m", "z": "m", "phi": "rad", "theta": "rad", "psi": "rad"}


@dataclass(frozen=True, eq=False)
class Predictor:
    """Predicts a recording from design points, shape (m,) of the free parameters; SI units."""

    free: FreeParameters
    plan: Layout
    course: Course

    @cached_property
    def dofs(self) -> tuple[str, ...]:
        """Degree of freedom of each state."""
        return self.free.nominal.dofs * 2

    @cached_property
    def states(self) -> tuple[str, ...]:
        """Names of the states: poses, then velocities."""
        return poses_of(self.free.nominal.dofs) + velocities_of(self.free.nominal.dofs)

    @cached_property
    def units(self) -> tuple[str, ...]:
        """Units of the states."""
        poses = tuple(POSE_UNIT[name] for name in poses_of(self.free.nominal.dofs))
        return poses + tuple(f"{unit}/s" for unit in poses)

    @cached_property
    def spread(self) -> Array:
        """Standard deviation of each measured state, 1 for one that does not move."""
        deviation = np.std(self.course.measured, axis=0)
        return np.where(deviation > 0.0, deviation, 1.0)

    def predict(self, point: Array, start: Array | None = None) -> Array:
        """Pose and velocity of one design point, shape (N, 2 n_dof).

        `start` (n, 2 n_dof) replaces the measured states that the n predictions begin with. The
        prediction is NaN where the inertia is not positive definite.
        """
        course = self.course
        if start is not None:
            begun = course.start.copy()
            begun[course.restart] = start
            course = course._replace(start=begun)
        tables = self.free.tables(point[None])
        entries = np.ascontiguousarray(self.plan.entries(tables)[:, 0])
        inverses, realistic = self.plan.inverse_inertia(tables)
        if not realistic[0]:
            return np.full_like(course.measured, np.nan)
        inverse = np.ascontiguousarray(inverses[..., 0])
        predicted = np.empty_like(course.measured)
        predict(self.plan.structure, entries, inverse, course, predicted)
        return predicted

    def errors(self, points: Array, metric: str) -> tuple[Array, Array, Flags]:
        """Prediction errors of n design points (n, m): per state (n, 2 n_dof), and two warnings.

        The warnings are the share of rates that had to be limited, (n,), and which points have
        an inertia that is positive definite, (n,).
        """
        tables = self.free.tables(points)
        inverse, realistic = self.plan.inverse_inertia(tables)
        errors = np.empty((len(points), len(self.states)))
        limited = np.empty(len(points))
        prediction_errors(
            self.plan.structure, self.plan.entries(tables), inverse, self.course,
            METRICS.index(metric), errors, limited,
        )  # fmt: skip
        stages = 4 if self.plan.structure.rk4 else 1
        return errors, limited / (stages * self.course.measured.size), realistic


def _canonical(label: str) -> str:
    """`surge.uu` as the parameters are called, `surge.u^2`."""
    dof, dot, name = label.partition(".")
    return f"{dof}.{basis.term(name)}" if dot else label


@dataclass(frozen=True)
class PredictionOptions(Identifier):
    """What the identifiers that compare predictions with a recording have in common.

    `parameters` are the free coefficients as `dof.term` (null: the nominal table's nonzero ones);
    `coriolis: tied` lets C(nu) nu follow from the inertia, `free` gives each of its coefficients
    to the fit; `ned_force` adds a force (`north`, `east`) that is constant in NED (null: to a
    vessel in surge, sway and yaw), for a free run sums up what is not modelled. Bounds are
    `dof.term: [lower, upper]`, in any spelling of the term; the other parameters lie between their
    nominal value divided and multiplied by `bound_factor` (null: anywhere). `force` is the force
    that drives the prediction (null: the command through the known lag, else the acting force
    where recorded, else the command). Predictions begin anew from the measured state every
    `horizon` samples (null: only at the first). Rates beyond `derivative_limit` (m/s, rad/s and
    per second again) are limited.
    """

    parameters: tuple[str, ...] | None
    coriolis: Coriolis
    ned_force: bool | None
    bounds: dict[str, tuple[float, ...]]
    bound_factor: float | None
    force: str | None
    integrator: Integrator
    horizon: int | None
    derivative_limit: float

    def __post_init__(self) -> None:
        check_force(self.force)
        if self.bound_factor is not None and not self.bound_factor > 1.0:
            raise ConfigurationError(
                f"bound_factor must be above 1 or null, got {self.bound_factor}"
            )
        if self.horizon is not None and self.horizon < 2:
            raise ConfigurationError(f"horizon must be at least 2 samples, got {self.horizon}")
        if not self.derivative_limit > 0.0:
            raise ConfigurationError(
                f"derivative_limit must be positive, got {self.derivative_limit}"
            )
        for label, pair in self.bounds.items():
            if len(pair) != 2 or not pair[0] < pair[1]:
                raise ConfigurationError(
                    f"bounds.{label}: expected a lower and a higher number, got {list(pair)}"
                )
        spelled = {_canonical(label): pair for label, pair in self.bounds.items()}
        object.__setattr__(self, "bounds", spelled)

    def needs(self) -> Needs:
        """The force."""
        return Needs(self.force, thruster_lag=self.force == "filtered")

    def free(self, nominal: Vessel) -> FreeParameters:
        """The free parameters of a vessel."""
        if self.ned_force and nominal.dofs != PLANAR:
            raise ConfigurationError(
                f"identifier.ned_force needs a vessel in {', '.join(PLANAR)}, "
                f"got one in {', '.join(nominal.dofs)}"
            )
        with_force = nominal.dofs == PLANAR if self.ned_force is None else self.ned_force
        free = free_parameters(nominal, self.parameters, self.coriolis, with_force)
        unknown = [label for label in self.bounds if label not in free.labels]
        if unknown:
            raise ConfigurationError(
                f"bounds.{unknown[0]}: not a parameter, expected one of {', '.join(free.labels)}"
            )
        return free

    def predictor(self, problem: Problem, horizon: int | None = None) -> Predictor:
        """Predictor of the training part; `horizon` overrides the option."""
        free = self.free(problem.nominal)
        nominal = free.nominal
        plan = layout(nominal.terms, nominal.dofs, free.support, self.integrator)
        course = course_of(
            problem.training, problem.thruster, self.force, horizon or self.horizon,
            self.derivative_limit,
        )  # fmt: skip
        return Predictor(free, plan, course)

    def box(self, free: FreeParameters) -> tuple[Array, Array]:
        """Lower and upper bounds of the parameters, infinite where there are none, shape (m,)."""
        lower, upper = np.full(len(free), -np.inf), np.full(len(free), np.inf)
        for i, (label, value) in enumerate(zip(free.labels, free.values, strict=True)):
            if label in self.bounds:
                lower[i], upper[i] = self.bounds[label]
            elif self.bound_factor is not None and value != 0.0:
                ends = (value / self.bound_factor, value * self.bound_factor)
                lower[i], upper[i] = min(ends), max(ends)
        return lower, upper
