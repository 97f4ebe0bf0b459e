"""A model with standard errors says whether they are of the coefficient or of the estimate only."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from seatrial.models.diagnostics import INTERVAL_OF_ESTIMATE
from seatrial.models.identification.auto import Auto
from seatrial.models.identification.problem import Identified, Identifier, Problem, with_interval
from tests.trials import composed

BIASED = ("ls", "ridge", "plsr", "nsga2", "dsr")


@dataclass(frozen=True)
class Biased(Identifier):
    """Halves the nominal model, with a standard error if one is given."""

    error: float | None = 1.0

    def identify(self, problem: Problem, rng: np.random.Generator) -> Identified:
        model = 0.5 * problem.nominal
        residual = model - problem.nominal
        errors = None if self.error is None else np.full(residual.theta.shape, self.error)
        return Identified(model, residual, errors)


@dataclass(frozen=True)
class Covering(Biased):
    @property
    def interval_covers(self) -> bool:
        return True


def said(identified: Identified) -> list[float | None]:
    return [f.value for f in identified.diagnostics if f.name == INTERVAL_OF_ESTIMATE]


@pytest.mark.parametrize(
    ("identifier", "values"),
    [(Biased(), [1.0]), (Covering(), [0.0]), (Covering(None), []), (Covering(float("nan")), [])],
)
def test_the_identifier_decides(calm: Any, identifier: Identifier, values: list[float]) -> None:
    rng = np.random.default_rng(0)
    once = with_interval(identifier, identifier.identify(calm.problem, rng))
    assert said(once) == values
    assert said(with_interval(Biased(), once)) == values  # what is said stays


@pytest.mark.parametrize("identifier", [Biased(), Covering()])
def test_a_selection_says_what_its_choice_says(calm: Any, identifier: Identifier) -> None:
    chosen = Auto({"only": identifier}, 4, 10.0, None)
    found = with_interval(chosen, chosen.identify(calm.problem, np.random.default_rng(0)))
    assert said(found) == [float(not identifier.interval_covers)]


@pytest.mark.parametrize(
    ("options", "covers"),
    [
        (("identifier=iv",), True),
        (("identifier=iv", "identifier.instruments=none"), False),  # least squares
        (("identifier=output_error",), True),
        *(((f"identifier={name}",), False) for name in BIASED),
    ],
)
def test_consistent_estimators_alone_have_intervals_of_the_coefficient(
    options: tuple[str, ...], covers: bool
) -> None:
    assert composed(*options).identifier.interval_covers is covers
