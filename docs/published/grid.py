"""The objective of the multi-objective search on a grid of two parameters.

    z(theta) = sum_j f_j(theta)                                                      (7.1)

with the objectives of `nsga2`. Hoyer (2021), section 7.5 and Figure 7.20. The grid shows the
valleys and local minima of the objective; its minimum is the estimate.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Ge

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError
from seatrial.models.identification.objectives import Metric, Objectives, objective_diagnostics
from seatrial.models.identification.predictor import PredictionOptions
from seatrial.models.identification.problem import Identified, Problem
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag

AXES = ("topology_first", "topology_second")


@dataclass(frozen=True)
class Grid(PredictionOptions):
    """Evaluation of the objective at `points` equidistant values of each of two parameters."""

    objective: Metric
    points: Annotated[int, Ge(2)]

    def check(self, nominal: Vessel, thruster: SecondOrderLag | None, measured: bool) -> None:
        """Raise ConfigurationError unless there are two parameters, both with bounds."""
        free = self.unknowns(nominal)
        if len(free) != len(AXES):
            raise ConfigurationError(
                f"identifier.parameters: got {', '.join(free.labels)}, expected two"
            )
        for label in free.labels:
            if self.inertia_factor is None and label not in self.bounds:
                raise ConfigurationError(f"bounds.{label}: got none, expected [lower, upper]")

    def identify(self, problem: Problem, rng: np.random.Generator) -> Identified:
        """The residual table of the lowest grid point, with the grid as diagnostics."""
        predictor = self.predictor(problem)
        objectives = Objectives(predictor, self.objective, grouped=False)
        free = predictor.free
        axes = np.linspace(*self.box(free, problem.training), self.points).T
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(AXES))
        z = objectives(points).sum(axis=1).reshape(self.points, self.points)
        rows = zip(AXES, free.dofs, free.labels, free.units, axes, strict=True)
        found = [
            Diagnostic(name, dof, float(value), unit, i, label=label)
            for name, dof, label, unit, axis in rows
            for i, value in enumerate(axis)
        ]
        found += [Diagnostic("topology", "all", float(v), "", *ij) for ij, v in np.ndenumerate(z)]
        found.append(Diagnostic("local_minima", "all", float(local_minima(z))))
        best = points[int(np.argmin(z))]
        found += objective_diagnostics(objectives, best)
        model, residual = free.model(problem.nominal, best), free.residual(best)
        return Identified(model, residual, None, tuple(found))


def local_minima(z: Array) -> int:
    """Number of interior points of the grid z (n, m) that are lower than all eight neighbours."""
    n, m = z.shape
    neighbours = [
        z[i : n - 2 + i, j : m - 2 + j] for i in range(3) for j in range(3) if (i, j) != (1, 1)
    ]
    return int(np.count_nonzero(np.all(z[1:-1, 1:-1] < np.array(neighbours), axis=0)))
