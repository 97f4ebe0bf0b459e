"""PLSR of terms with unit variance, Jervan (2020), section 4.3.2 before eq. (4.8)."""

from dataclasses import dataclass, replace

import numpy as np

from seatrial.models.identification.plsr import Columns, Plsr
from seatrial.models.identification.residual import Samples


@dataclass(frozen=True)
class UnitVariance(Plsr):
    """PLSR that does not divide the terms by their order: beta = 1."""

    def columns(self, samples: Samples) -> Columns:
        """Standardised columns of the samples, all of them with beta = 1."""
        z = super().columns(samples)
        return replace(z, beta=np.ones_like(z.beta))
