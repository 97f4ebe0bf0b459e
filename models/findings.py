"""A number that a part says of itself: what an identifier, a controller or an excitation reports.

It is stored as it is, as a row of the table `diagnostic`.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """One number, such as the error at model order `i`.

    A surface has the order in `i` and the number of variables in `j`; a Pareto set the point in
    `i`, the parameter in `j` and its name in `label`. `dof` is a degree of freedom or `all`.
    """

    name: str
    dof: str
    value: float | None
    unit: str = ""
    i: int | None = None
    j: int | None = None
    label: str | None = None
