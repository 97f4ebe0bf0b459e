"""Objectives of the multi-objective search. Hoyer (2021), sections 3.5.2 and 6.2.1.

One objective per state, pose and velocity of each degree of freedom,

    f_j(theta) = 1/N sum_k |y_j(k) - y_hat_j(k, theta)|                                  (6.4)

or two, `grouped`: the poses and the velocities, each the mean over the degrees of freedom of the
error divided by the state's standard deviation. (6.4) is printed with the magnitude inside the
sum (`mae`); the thesis's figures came from the magnitude of the mean error (`mean_error`).
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge

from seatrial.models.errors import ConfigurationError
from seatrial.models.findings import Finding
from seatrial.models.identification.predictor import PredictionOptions, Predictor
from seatrial.models.identification.problem import Identified, Problem
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag

Metric = Literal["mae", "mse", "smape", "mean_error"]


@dataclass(frozen=True, eq=False)
class Objectives:
    """The objectives as a function of many design points."""

    predictor: Predictor
    metric: str  # mae, mse, smape or mean_error
    grouped: bool

    @cached_property
    def scale(self) -> Array:
        """Error of an uninformative prediction of each state: the spread or 100 %, (2 n_dof,)."""
        spread = self.predictor.spread
        if self.metric == "smape":
            return np.full_like(spread, 100.0)
        return spread**2 if self.metric == "mse" else spread

    @cached_property
    def floor(self) -> Array:
        """Value of an uninformative prediction of each objective, shape (n_objectives,)."""
        return np.ones(2) if self.grouped else self.scale

    @property
    def labels(self) -> tuple[tuple[str, str, str], ...]:
        """(degree of freedom, name, unit) of each objective."""
        predictor = self.predictor
        if self.grouped:
            return (("all", "pose", ""), ("all", "velocity", ""))
        power = {"mse": "^2", "smape": None}.get(self.metric, "")
        units = [
            "%" if power is None else f"({unit}){power}" if power else unit
            for unit in predictor.units
        ]
        return tuple(zip(predictor.dofs, predictor.states, units, strict=True))

    @property
    def penalty(self) -> float:
        """Error of a state as large as the limit of the rates."""
        limit = self.predictor.course.limit
        return {"mse": limit**2, "smape": 200.0}.get(self.metric, limit)

    def __call__(self, points: Array) -> Array:
        """Objectives of n design points (n, m), shape (n, n_objectives); always finite.

        A penalty of at least the limit is added for a point whose rates had to be limited (Hoyer,
        section 6.4), growing with the share of limited rates; a further one is added if the
        inertia is not positive definite.
        """
        errors, limited, realistic = self.predictor.errors(points, self.metric)
        worse = np.where(limited > 0.0, 1.0 + limited, 0.0) + np.where(realistic, 0.0, 3.0)
        errors = errors + self.penalty * worse[:, None]
        if not self.grouped:
            return errors
        share = errors / self.scale
        n = share.shape[1] // 2
        return np.column_stack([share[:, :n].mean(axis=1), share[:, n:].mean(axis=1)])


def objective_findings(objectives: Objectives, point: Array) -> list[Finding]:
    """The objectives of one design point (m,) over the training part."""
    values = objectives(point[None])[0]
    return [
        Finding("objective", dof, float(value), unit, label=name)
        for (dof, name, unit), value in zip(objectives.labels, values, strict=True)
    ]


# The objective of the multi-objective search on a grid of two parameters.
#
#     z(theta) = sum_j f_j(theta)                                                      (7.1)
#
# with the objectives of `nsga2`. Hoyer (2021), section 7.5 and Figure 7.20. The grid shows the
# valleys and local minima of the objective; its minimum is the estimate.


AXES = ("topology_first", "topology_second")
MOST_NAMED = 6  # of the parameters in an error message


@dataclass(frozen=True)
class Grid(PredictionOptions):
    """Evaluation of the objective at `points` equidistant values of each of two parameters."""

    objective: Metric
    points: Annotated[int, Ge(2)]

    def check(self, nominal: Vessel, thruster: SecondOrderLag | None, measured: bool) -> None:
        """Raise ConfigurationError unless there are two parameters, both with bounds."""
        free = self.unknowns(nominal)
        if len(free) != len(AXES):
            some = ", ".join(free.labels[:MOST_NAMED])
            more = ", ..." if len(free) > MOST_NAMED else ""
            raise ConfigurationError(
                f"identifier.parameters: got {len(free)} ({some}{more}), expected two"
            )
        self.check_bounded(free)

    def identify(self, problem: Problem, rng: np.random.Generator) -> Identified:
        """The residual table of the lowest grid point, with the grid as findings."""
        self.check(problem.nominal, problem.thruster, measured=False)
        predictor = self.predictor(problem)
        objectives = Objectives(predictor, self.objective, grouped=False)
        free = predictor.free
        axes = np.linspace(*self.box(free, problem.training), self.points).T
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(AXES))
        z = objectives(points).sum(axis=1).reshape(self.points, self.points)
        findings = [
            Finding(name, dof, float(value), unit, i, label=label)
            for name, dof, label, unit, axis in zip(
                AXES, free.dofs, free.labels, free.units, axes, strict=True
            )
            for i, value in enumerate(axis)
        ]
        findings += [
            Finding("topology", "all", float(value), "", i, j)
            for (i, j), value in np.ndenumerate(z)
        ]
        findings.append(Finding("local_minima", "all", float(local_minima(z))))
        best = points[int(np.argmin(z))]
        findings += objective_findings(objectives, best)
        residual = free.residual(best)
        return Identified(free.model(problem.nominal, best), residual, None, tuple(findings))


def local_minima(z: Array) -> int:
    """Number of interior points of the grid z (n, m) that are lower than all eight neighbours."""
    inner = z[1:-1, 1:-1]
    n, m = z.shape
    lower = np.ones_like(inner, dtype=bool)
    for i in range(3):
        for j in range(3):
            if (i, j) != (1, 1):
                lower &= inner < z[i : n - 2 + i, j : m - 2 + j]
    return int(np.count_nonzero(lower))
