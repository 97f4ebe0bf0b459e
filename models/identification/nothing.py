"""No identification: the nominal model as it is, the reference of every comparison."""

from dataclasses import dataclass

import numpy as np

from models.identification.problem import Identified, Problem
from models.vessel import Vessel


@dataclass(frozen=True)
class NoIdentifier:
    """Learns nothing: F1 = F0, a residual table without terms."""

    def identify(self, problem: Problem, rng: np.random.Generator) -> Identified:
        """The nominal model."""
        nominal = problem.nominal
        empty = Vessel("residual", nominal.dofs, (), np.zeros((0, len(nominal.dofs))))
        return Identified(nominal, empty)
