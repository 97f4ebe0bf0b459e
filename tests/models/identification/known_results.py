"""Identifiers with a known result, for the tests of what chooses among identifiers."""

from dataclasses import dataclass

import numpy as np

from seatrial.models.errors import IdentificationError
from seatrial.models.identification.problem import Identified, Identifier, Problem


@dataclass(frozen=True)
class Given(Identifier):
    """An identifier that returns a factor of the nominal model, whatever the data."""

    factor: float

    def identify(self, problem: Problem, rng: np.random.Generator) -> Identified:
        model = self.factor * problem.nominal
        return Identified(model, model - problem.nominal)


@dataclass(frozen=True)
class Failing(Identifier):
    """An identifier that fails, whatever the data."""

    def identify(self, problem: Problem, rng: np.random.Generator) -> Identified:
        raise IdentificationError("always")
