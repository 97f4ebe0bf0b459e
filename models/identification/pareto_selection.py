"""Choosing one point of a Pareto front. Hoyer (2021), section 6.2.3.

Objectives are normalised to [0, 1] over the front; an objective in which the front has no extent
counts as 0 for every point.
"""

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from seatrial.models.vessel.basis import Array

RADIUS = 0.125  # of the neighbourhood in which trade-offs are compared, in normalised objectives
OUTLIER = 2.0  # standard deviations above the mean trade-off that make a knee
Decision = Literal["knee", "ideal", "pseudo_weights"]


def normalised(front: Array) -> Array:
    """(f - ideal) / (nadir - ideal), shape (n, n_objectives)."""
    ideal, nadir = front.min(axis=0), front.max(axis=0)
    extent = np.where(nadir > ideal, nadir - ideal, 1.0)
    return np.asarray((front - ideal) / extent)


def nearest_to_ideal(front: Array) -> int:
    """The point with the smallest normalised distance to the ideal point."""
    return int(np.argmin(np.linalg.norm(normalised(front), axis=1)))


def knees(front: Array) -> NDArray[np.int64]:
    """High trade-off points: where every neighbour pays much for little. Blank & Deb (2020a).

    mu_i = min over neighbours j of sum max(0, f_j - f_i) / sum max(0, f_i - f_j): the least
    sacrifice per gain when leaving point i. A knee is an outlier: mu above its mean by two
    standard deviations, else the largest one if above by one. Often there is none; the answer is
    then empty, as it is for fewer than three points.
    """
    points = normalised(front)
    n, m = points.shape
    if n < 3:
        return np.zeros(0, dtype=np.int64)
    tree, least = cKDTree(points), min(2 * m, n - 1)
    mu = np.full(n, np.nan)
    for i, point in enumerate(points):
        near = tree.query_ball_point(point, RADIUS)
        if len(near) < least:
            near = tree.query(point, k=least + 1)[1]
        change = points[near] - point
        sacrifice = np.maximum(change, 0.0).sum(axis=1)
        gain = np.maximum(-change, 0.0).sum(axis=1)
        useful = gain > 0.0
        if np.any(useful):
            mu[i] = np.min(sacrifice[useful] / gain[useful])
    return _upper_outliers(mu)


def _upper_outliers(mu: Array) -> NDArray[np.int64]:
    """Indices of the values that stand out above the others; NaN takes no part."""
    known = np.flatnonzero(np.isfinite(mu))
    if len(known) < 2 or np.ptp(mu[known]) == 0.0:
        return np.zeros(0, dtype=np.int64)
    deviation = (mu[known] - np.mean(mu[known])) / np.std(mu[known])
    if np.max(deviation) >= OUTLIER:
        return np.asarray(known[deviation >= OUTLIER])
    return known[[np.argmax(deviation)]] if np.max(deviation) > 1.0 else known[:0]


def pseudo_weights(front: Array) -> Array:
    """w_ij = share of objective j in the distance of point i from the nadir, shape of front."""
    distance = 1.0 - normalised(front)
    total = distance.sum(axis=1, keepdims=True)
    return np.asarray(distance / np.where(total > 0.0, total, 1.0))


def choose(front: Array, decision: Decision, weights: tuple[float, ...] | None) -> tuple[int, str]:
    """Index of the chosen point and the rule that chose it.

    `knee` takes the knee nearest to the ideal point, and where there is none the point that is;
    `pseudo_weights` the point whose pseudo-weights are nearest to `weights` (null: equal ones).
    """
    if decision == "pseudo_weights":
        wanted = np.ones(front.shape[1]) if weights is None else np.array(weights)
        wanted = wanted / np.sum(wanted)
        return int(np.argmin(np.abs(pseudo_weights(front) - wanted).sum(axis=1))), decision
    found = knees(front) if decision == "knee" else np.zeros(0, dtype=np.int64)
    if len(found):
        distance = np.linalg.norm(normalised(front)[found], axis=1)
        return int(found[np.argmin(distance)]), "knee"
    return nearest_to_ideal(front), "ideal"
