"""Coefficients of a trial as rows of the logbook, and a vessel made again from such rows.

The database is the model:

    with Reader.read("sqlite:///results/results.db") as logbook:
        vessel = stored_vessel(logbook, run_id=17, model="identified")
"""

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from seatrial.models.errors import LogbookError
from seatrial.models.identification.problem import Identified
from seatrial.models.notation import DOFS
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import Term
from seatrial.models.vessel.table import (
    Vessel,
    coefficient_unit,
)
from seatrial.runner.database.records import Coefficient

if TYPE_CHECKING:
    from seatrial.runner.database import Reader


def stored_vessel(logbook: "Reader", run_id: int, model: str = "identified") -> Vessel:
    """The coefficient table of a model (nominal, residual, identified, plant) of a run.

    Raises LogbookError when the run stored no such model.
    """
    rows = [row for row in logbook.coefficients(run_id) if row.model == model]
    if not rows:
        raise LogbookError(f"run {run_id} has no coefficients of a model {model!r}")
    return vessel_of(rows, f"{model} model of run {run_id}")


def vessel_of(rows: Iterable[Coefficient], name: str) -> Vessel:
    """The table that some coefficient rows of one model make; terms keep their order."""
    values = {(row.term, row.dof): row.value for row in rows}
    names = list(dict.fromkeys(term for term, _ in values))
    present = {dof for _, dof in values}
    dofs = tuple(dof for dof in DOFS if dof in present)
    theta = [[values.get((term, dof), 0.0) for dof in dofs] for term in names]
    return Vessel(name, dofs, basis.terms(names), np.array(theta))


def coefficients(
    nominal: Vessel, identified: Identified, truth: Vessel | None
) -> list[Coefficient]:
    """Every coefficient that is not zero, with its standard error and true value where known."""
    truths = {
        "nominal": truth,
        "residual": None if truth is None else truth - nominal,
        "identified": truth,
        "plant": None,
    }
    tables = {"nominal": nominal, "residual": identified.residual, "identified": identified.model}
    if truth is not None:
        tables["plant"] = truth
    errors = _standard_errors(identified)
    found = []
    for model, table in tables.items():
        true = truths[model]
        union = table if true is None or model == "nominal" else (0.0 * true) + table
        for one, row in zip(union.terms, union.theta, strict=True):
            for dof, value in zip(union.dofs, row, strict=True):
                error = errors.get((one, dof)) if model in ("residual", "identified") else None
                truth_here = None if true is None else true.coefficient(dof, one.name)
                if value or error is not None or truth_here:
                    unit = coefficient_unit(one, dof)
                    found.append(
                        Coefficient(model, dof, one.name, float(value), error, truth_here, unit)
                    )
    return found


def _standard_errors(identified: Identified) -> dict[tuple[Term, str], float]:
    """Standard error of each estimated coefficient, by term and degree of freedom."""
    if identified.std_error is None:
        return {}
    residual = identified.residual
    return {
        (one, dof): float(identified.std_error[i, j])
        for i, one in enumerate(residual.terms)
        for j, dof in enumerate(residual.dofs)
        if np.isfinite(identified.std_error[i, j])
    }


def state_space_coefficients(identified: Identified) -> list[Coefficient]:
    """Every matrix entry of a state-space model, as model `state_space`, term `A[1,2]`."""
    model = identified.state_space
    if model is None:
        return []
    matrices = {
        "A": model.A, "B": model.B, "C": model.C, "D": model.D, "K": model.K, "F": model.F,
        "x0": model.x0,
    }  # fmt: skip
    return [
        Coefficient(
            "state_space", "all", f"{name}[{','.join(str(k + 1) for k in place)}]", float(value),
            None, None, "",
        )
        for name, matrix in matrices.items()
        if matrix is not None
        for place, value in np.ndenumerate(matrix)
    ]  # fmt: skip


def table_coefficients(tables: Mapping[str, Vessel]) -> list[Coefficient]:
    """The coefficients of several tables by the name of their model; zeros are left out."""
    return [
        Coefficient(model, dof, one.name, float(value), None, None, coefficient_unit(one, dof))
        for model, table in tables.items()
        for one, row in zip(table.terms, table.theta, strict=True)
        for dof, value in zip(table.dofs, row, strict=True)
        if value
    ]


def numbered(name: str, tables: Iterable[Vessel]) -> dict[str, Vessel]:
    """Tables named `stage_1`, `stage_2` and so on."""
    return {f"{name}_{i}": table for i, table in enumerate(tables, start=1)}
