"""The objective of the multi-objective search on a grid of two parameters.

    z(theta) = sum_j f_j(theta)                                                      (7.1)

with the objectives of `nsga2`. Hoyer (2021), section 7.5 and Figure 7.20. The grid shows the
valleys and islands that a search has to get through; its minimum is the estimate.
"""

from dataclasses import dataclass

import numpy as np

from models.basis import Array
from models.errors import ConfigurationError
from models.identification.free_parameters import NED
from models.identification.objectives import Metric, Objectives, objective_findings
from models.identification.predictor import PredictionOptions
from models.identification.problem import Finding, Identified, Problem
from models.thruster import SecondOrderLag
from models.vessel import Vessel

AXES = ("topology_first", "topology_second")
MOST_NAMED = 6  # of the parameters, in a complaint


@dataclass(frozen=True)
class Grid(PredictionOptions):
    """`points` values of each of two parameters, evenly over its bounds."""

    objective: Metric
    points: int

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.points < 2:
            raise ConfigurationError(f"points must be at least 2, got {self.points}")

    def check(self, nominal: Vessel, thruster: SecondOrderLag | None, measured: bool) -> None:
        """Refuse other than two parameters, and parameters without bounds."""
        free = self.free(nominal)
        if len(free) != len(AXES):
            some = ", ".join(free.labels[:MOST_NAMED])
            more = ", ..." if len(free) > MOST_NAMED else ""
            raise ConfigurationError(
                f"identifier.parameters: got {len(free)} ({some}{more}), expected two"
            )
        lower, upper = self.box(free)
        for label, low, high in zip(free.labels, lower, upper, strict=True):
            if label in NED or not np.isfinite(high - low):
                raise ConfigurationError(
                    f"identifier.bounds.{label} is missing: a grid needs bounds"
                )

    def identify(self, problem: Problem, rng: np.random.Generator) -> Identified:
        """The residual table of the grid's lowest point; the grid as findings."""
        self.check(problem.nominal, problem.thruster, measured=False)
        predictor = self.predictor(problem)
        objectives = Objectives(predictor, self.objective, grouped=False)
        free = predictor.free
        axes = np.linspace(*self.box(free), self.points).T
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(AXES))
        z = objectives(points).sum(axis=1).reshape(self.points, self.points)
        findings = [
            Finding(name, label.partition(".")[0], float(value), unit, i, label=label)
            for name, label, unit, axis in zip(AXES, free.labels, free.units, axes, strict=True)
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
        return Identified(problem.nominal + residual, residual, None, tuple(findings))


def local_minima(z: Array) -> int:
    """Grid points that are lower than all eight neighbours, those on the edge not counted."""
    inner = z[1:-1, 1:-1]
    n, m = z.shape
    lower = np.ones_like(inner, dtype=bool)
    for i in range(3):
        for j in range(3):
            if (i, j) != (1, 1):
                lower &= inner < z[i : n - 2 + i, j : m - 2 + j]
    return int(np.count_nonzero(lower))
