"""Coefficients of a trial as rows of the logbook, and a vessel made again from such rows.

The database is the model:

    with Reader.read("sqlite:///results/results.db") as logbook:
        vessel = stored_vessel(logbook, run_id=17, model="identified")
"""

from collections.abc import Iterable
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
from seatrial.runner.database.records import Coefficient, Diagnostic

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


MATRICES = ("A", "B", "C", "D", "K", "F", "x0")  # of a state-space model


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


def identification_findings(identified: Identified) -> list[Diagnostic]:
    """The identifier's findings, but for the matrix entries, which are coefficients."""
    return [
        Diagnostic(f.name, f.dof, f.i, f.j, f.label, f.value, f.unit)
        for f in identified.findings
        if f.name not in MATRICES
    ]


def state_space_coefficients(identified: Identified) -> list[Coefficient]:
    """Every matrix entry of a state-space model, as model `state_space`, term `A[1,2]`."""
    found = []
    for f in identified.findings:
        if f.name in MATRICES:
            place = f"[{f.i},{f.j}]" if f.j else f"[{f.i}]"
            term = f"{f.name}{place}"
            found.append(Coefficient("state_space", f.dof, term, f.value, None, None, f.unit))
    return found


def stage_coefficients(identified: Identified) -> list[Coefficient]:
    """The residual table of each stage, as models `stage_1` and so on; zeros left out."""
    return [
        Coefficient(
            f"stage_{i}", dof, one.name, float(value), None, None, coefficient_unit(one, dof)
        )
        for i, table in enumerate(identified.stages, start=1)
        for one, row in zip(table.terms, table.theta, strict=True)
        for dof, value in zip(table.dofs, row, strict=True)
        if value
    ]
