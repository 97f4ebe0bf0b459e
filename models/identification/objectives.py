"""Objectives of the multi-objective search. Hoyer (2021), sections 3.5.2 and 6.2.1.

One objective per state, pose and velocity of each degree of freedom,

    f_j(theta) = 1/N sum_k |y_j(k) - y_hat_j(k, theta)|                                  (6.4)

or two, `grouped`: the poses and the velocities, each the mean over the degrees of freedom of the
error divided by the state's standard deviation. (6.4) is printed with the magnitude inside the
sum (`mae`); the thesis's figures came from the magnitude of the mean error (`mean_error`).
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.identification.predictor import Predictor
from seatrial.models.vessel.basis import Array

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
        states = self.predictor.states
        if self.grouped:
            return (("all", "pose", ""), ("all", "velocity", ""))
        power = {"mse": "^2", "smape": None}.get(self.metric, "")
        units = [
            "%" if power is None else f"({unit}){power}" if power else unit for unit in states.units
        ]
        return tuple(zip(states.dofs, states.names, units, strict=True))

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


def objective_diagnostics(objectives: Objectives, point: Array) -> list[Diagnostic]:
    """The objectives of one design point (m,) over the training part."""
    values = objectives(point[None])[0]
    rows = zip(objectives.labels, values, strict=True)
    return [
        Diagnostic("objective", dof, float(value), unit, j=j, label=name)
        for j, ((dof, name, unit), value) in enumerate(rows)
    ]
