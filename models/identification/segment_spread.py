"""The spread of parameters that were refined by free runs over segments.

With J the weighted derivatives, the initial velocities projected out, P the prior's precision and
e the weighted residuals, p_hat - p = H^-1 J' e with H = J'J + P. Where e has a slow part, such as
that of a wind that was measured with noise or of terms that the model lacks, residuals may depend
on each other throughout a segment.

The standard errors are the largest of what is known of each parameter. For models that are drawn
they will not do: coefficients of a ship are strongly correlated, and different factors on their
deviations, with correlations that are not theirs, are far larger in what all of them predict. There
one covariance is taken as a whole.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from seatrial.models.identification.uncertainty import (
    clustered_covariance,
    clustered_variance,
    long_run_share,
    stationary_covariance,
    stationary_variance,
)
from seatrial.models.vessel.basis import Array

SLOW = 0.1  # of a segment, at which the residual's slow part is looked for
SLOW_SHARE = 1.1  # variance at low frequency, over that of white noise, from which there is one
MANY = 20  # segments, from which a covariance of their sums is of use


@dataclass(frozen=True, eq=False)
class SegmentSpread:
    """What the spread of m parameters is computed from."""

    inverse: Array  # H^-1 (m, m)
    gains: Array  # J H^-1 (N, n_dof, m)
    rest: Array  # e (N, n_dof)
    begin: NDArray[np.int64]  # first samples of the segments
    freedom: float  # samples over those that the unknowns leave
    prior: Array  # (m,) tau P, of the prior's share in the error

    @cached_property
    def covariance(self) -> Array:
        """Covariance (m, m) for standard errors, with the correlations for white residuals.

        An active constraint does not narrow it.
        """
        variance = self.freedom * self._residual_variance()
        variance += np.einsum("ij,j,ij->i", self.inverse, self.prior, self.inverse)
        deviation = np.sqrt(variance / np.diag(self.inverse))
        return np.asarray(self.inverse * np.outer(deviation, deviation))

    @cached_property
    def joint(self) -> Array:
        """Covariance (m, m) of which models are drawn."""
        prior = (self.inverse * self.prior) @ self.inverse
        return np.asarray(self.freedom * self._residual_covariance() + prior)

    @cached_property
    def _slow(self) -> bool:
        shares = long_run_share(self.rest, SLOW * self._length)
        return bool(np.any(shares > SLOW_SHARE))

    @property
    def _length(self) -> float:
        """Samples of a segment."""
        return len(self.rest) / len(self.begin)

    @cached_property
    def _influence(self) -> Array:
        """Of every sample on the parameters (N, m)."""
        return np.asarray(np.einsum("ndm,nd->nm", self.gains, self.rest))

    def _residual_variance(self) -> Array:
        """Variance (m,) of sum_k G_k e_k."""

        def total(width: float | None) -> Array:
            parts = [
                stationary_variance(self.gains[:, d], self.rest[:, d], width)
                for d in range(self.rest.shape[1])
            ]
            return np.asarray(np.sum(parts, axis=0))

        short = total(None)
        if not self._slow:
            return short
        clustered = clustered_variance(self._influence, self.begin)
        return np.asarray(np.max([short, total(self._length), clustered], axis=0))

    def _residual_covariance(self) -> Array:
        """Covariance (m, m) of sum_k G_k e_k, the largest in the mean over the parameters."""

        def total(width: float | None) -> Array:
            parts = [
                stationary_covariance(self.gains[:, d], self.rest[:, d], width)
                for d in range(self.rest.shape[1])
            ]
            return np.asarray(np.sum(parts, axis=0))

        short = total(None)
        if not self._slow:
            return short
        known = [short, total(self._length)]
        if len(self.begin) >= MANY:
            known.append(clustered_covariance(self._influence, self.begin))
        white = np.diag(self.inverse)
        return known[int(np.argmax([np.mean(np.diag(each) / white) for each in known]))]
