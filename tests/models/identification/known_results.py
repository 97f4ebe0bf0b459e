"""Identifiers with a known result, and what a result says of itself."""

from dataclasses import dataclass

import numpy as np

from seatrial.models.diagnostics import Diagnostic
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


def diagnostics(found: Identified, name: str) -> list[Diagnostic]:
    return [f for f in found.diagnostics if f.name == name]


def labels(found: Identified, name: str) -> list[str]:
    return [f.label or "" for f in diagnostics(found, name)]


def chosen(found: Identified) -> str | None:
    """The label of the one alternative that was chosen."""
    (name,) = [f.label for f in diagnostics(found, "chosen") if f.value == 1.0]
    return name
