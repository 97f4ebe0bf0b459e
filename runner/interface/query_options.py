"""Options of tables and figures in Python; their names are those of `seatrial-results`."""

from collections.abc import Sequence
from typing import Literal, TypedDict

Names = str | Sequence[str]
Kind = Literal["nominal", "identified", "plant", "adaptive"]


TABLE_LISTS = ("metric", "coefficient", "dof", "stage", "model", "statistic", "baseline", "pool")
PLOT_LISTS = ("dof", "pool")


class Selected(TypedDict, total=False):
    """Which runs: conditions of the options of the same names of `seatrial-results`."""

    where: str  # "seed<10 and identifier=ls"
    sweep: int | str  # number or name of a sweep, or "all"
    tag: str


class TableArguments(Selected, total=False):
    """Options of `seatrial-results table`; several names as a list or comma-separated."""

    rows: Names
    columns: Names
    metric: Names
    coefficient: Names
    coefficients: bool
    dof: Names
    stage: Names
    model: Names
    statistic: Names
    interval: Literal["t", "bootstrap"]
    baseline: Names
    pool: Names
    digits: int
    cells: int


class PlotArguments(Selected, total=False):
    """Options of `seatrial-results plot`."""

    run: int
    metric: str
    rows: str
    columns: str
    dof: Names
    model: str
    facet: str
    log: bool
    pool: Names


def listed(names: Names | None) -> tuple[str, ...]:
    """Return names as a tuple; text is one name, or several with commas, as the shell takes it."""
    if names is None:
        return ()
    return (names,) if isinstance(names, str) else tuple(names)
