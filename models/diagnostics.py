"""Numbers that an identifier, a controller or an excitation reports about its own result.

A diagnostic is stored unchanged as a row of the table `diagnostic`.
"""

from dataclasses import dataclass

# 1: the standard errors are of the estimate only, which may be biased; 0: of the coefficient.
INTERVAL_OF_ESTIMATE = "interval_of_estimate"
TRAINING_TIME = "training_time"  # wall-clock time of the identification, machine code included


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
