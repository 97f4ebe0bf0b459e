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
    long_run_share,
    stationary_covariance,
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
        variance = self.freedom * np.max([np.diag(each) for each in self._known], axis=0)
        variance += np.einsum("ij,j,ij->i", self.inverse, self.prior, self.inverse)
        deviation = np.sqrt(variance / np.diag(self.inverse))
        return np.asarray(self.inverse * np.outer(deviation, deviation))

    @cached_property
    def joint(self) -> Array:
        """Covariance (m, m) of which models are drawn: the largest in the mean."""
        known = self._known if len(self.begin) >= MANY else self._known[:2]
        sizes = [np.mean(np.diag(each) / np.diag(self.inverse)) for each in known]
        prior = (self.inverse * self.prior) @ self.inverse
        return np.asarray(self.freedom * known[int(np.argmax(sizes))] + prior)

    @cached_property
    def _known(self) -> list[Array]:
        """Covariances (m, m) of sum_k G_k e_k; where e has a slow part, that of segments last."""
        length = len(self.rest) / len(self.begin)
        if np.all(long_run_share(self.rest, SLOW * length) <= SLOW_SHARE):
            return [self._stationary(None)]
        influence = np.einsum("ndm,nd->nm", self.gains, self.rest)
        clustered = clustered_covariance(influence, self.begin)
        return [self._stationary(None), self._stationary(length), clustered]

    def _stationary(self, width: float | None) -> Array:
        """Covariance (m, m) for stationary residuals, with Andrews's bandwidth or a given one."""
        axes = zip(self.gains.transpose(1, 0, 2), self.rest.T, strict=True)
        parts = [stationary_covariance(gain, rest, width) for gain, rest in axes]
        return np.asarray(np.sum(parts, axis=0))
