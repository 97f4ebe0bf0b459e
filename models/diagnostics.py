"""Numbers that an identifier, a controller or an excitation reports about its own result.

A diagnostic is stored unchanged as a row of the table `diagnostic`.
"""

from collections.abc import Iterable
from dataclasses import dataclass

# 1: the standard errors are of the estimate only, which may be biased; 0: of the coefficient.
INTERVAL_OF_ESTIMATE = "interval_of_estimate"
TRAINING_TIME = "training_time"  # wall-clock time of the identification, machine code included
WORSE_THAN_NOMINAL, DID_NOT_MOVE, NOT_EXCITED = "worse_than_nominal", "did_not_move", "not_excited"
# Why an axis keeps its nominal equation, by the diagnostic of the axis.
NOMINAL_EQUATION = {
    WORSE_THAN_NOMINAL: "the identified one simulates worse, or without skill",
    DID_NOT_MOVE: "it moved by no more than its noise",
    NOT_EXCITED: "other forces than the recorded one moved it",
}


@dataclass(frozen=True)
class Diagnostic:
    """A reported number, such as the error at model order `i`.

    For an error surface, `i` is the order and `j` the number of variables. For a Pareto set, `i`
    is the point, `j` the parameter and `label` the name of the parameter. `dof` is a degree of
    freedom or `all`.
    """

    name: str
    dof: str
    value: float | None
    unit: str = ""
    i: int | None = None
    j: int | None = None
    label: str | None = None


def nominal_equations(diagnostics: Iterable[Diagnostic]) -> str | None:
    """Which axes keep their nominal equation, and why, in one line; None if none does."""
    kept = [(one.name, one.dof) for one in diagnostics if one.name in NOMINAL_EQUATION]
    own = {name: ", ".join(dict.fromkeys(d for n, d in kept if n == name)) for name, _ in kept}
    told = "; ".join(f"{dofs}: {NOMINAL_EQUATION[name]}" for name, dofs in own.items())
    return f"nominal equations: {told}" if told else None
