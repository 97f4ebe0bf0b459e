"""A vessel from the coefficient rows of any run: the database is the model.

with Reader.read("sqlite:///results/results.db") as logbook:
    vessel = stored_vessel(logbook, run_id=17, model="identified")
"""

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from models import basis
from models.basis import DOFS
from models.errors import LogbookError
from models.vessel import Vessel
from runner.database.records import Coefficient

if TYPE_CHECKING:
    from runner.database import Reader


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
