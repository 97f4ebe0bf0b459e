"""Coefficients of a trial as rows of the logbook, and vessels built from stored rows."""

from collections.abc import Iterable, Mapping
from types import MappingProxyType

import numpy as np

from seatrial.models.identification.problem import Identified
from seatrial.models.notation import DOFS
from seatrial.models.vessel.basis import Term, terms
from seatrial.models.vessel.table import Vessel, coefficient_unit
from seatrial.runner.record.rows import Coefficient


def vessel_of(rows: Iterable[Coefficient], name: str) -> Vessel:
    """Build the coefficient table from the rows of one model; the terms keep their order.

    The rows of devices are left out (`device_values`).
    """
    values = {(row.term, row.dof): row.value for row in rows if row.dof in DOFS}
    names = list(dict.fromkeys(term for term, _ in values))
    present = {dof for _, dof in values}
    dofs = tuple(dof for dof in DOFS if dof in present)
    theta = [[values.get((term, dof), 0.0) for dof in dofs] for term in names]
    return Vessel(name, dofs, terms(names), np.array(theta))


def device_values(rows: Iterable[Coefficient]) -> dict[str, dict[str, float]]:
    """Return the parameters of devices among the rows of one model, by device and name."""
    values: dict[str, dict[str, float]] = {}
    for row in rows:
        if row.dof not in DOFS and row.value is not None:
            values.setdefault(row.dof, {})[row.term] = row.value
    return values


def coefficients(
    nominal: Vessel, identified: Identified, truth: Vessel | None
) -> list[Coefficient]:
    """Return every non-zero coefficient, with its standard error and true value if known.

    The parameters of devices follow, where they were identified, as `dof` the name of the device,
    then the tables of the stages and the matrices of a state-space model.
    """
    residual, deviations = identified.residual, identified.std_error
    errors = {
        (residual.terms[i], residual.dofs[j]): float(deviation)
        for (i, j), deviation in np.ndenumerate([[]] if deviations is None else deviations)
        if np.isfinite(deviation)
    }
    models = {"nominal": nominal, "identified": identified.model}
    rows = [
        *_of_table("nominal", nominal, None if truth is None else truth.on(nominal.terms)),
        *_of_table("residual", residual, None if truth is None else truth - nominal, errors),
        *_of_table("identified", identified.model, truth, errors),
    ]
    if truth is not None:
        models["plant"] = truth
        rows += _of_table("plant", truth)
    rows += _device_rows(models, identified)
    return rows + numbered("stage", identified.stages) + state_space_coefficients(identified)


def _of_table(
    model: str,
    table: Vessel,
    truth: Vessel | None = None,
    errors: Mapping[tuple[Term, str], float] = MappingProxyType({}),
) -> list[Coefficient]:
    """Return the coefficients of a table whose value, true value or standard error is not zero."""
    table = table if truth is None else 0.0 * truth + table
    true = None if truth is None else truth.on(table.terms).theta
    return [
        Coefficient(
            model, dof, term.name, float(table.theta[i, j]), errors.get((term, dof)),
            None if true is None else float(true[i, j]), coefficient_unit(term, dof),
        )
        for i, term in enumerate(table.terms)
        for j, dof in enumerate(table.dofs)
        if table.theta[i, j] or (term, dof) in errors or (true is not None and true[i, j])
    ]  # fmt: skip


def _device_rows(models: Mapping[str, Vessel], identified: Identified) -> list[Coefficient]:
    """Return the parameters of devices of several models, if they were identified."""
    before, after = (models[name].installed for name in ("nominal", "identified"))
    if not identified.device_errors and np.array_equal(before.parameters, after.parameters):
        return []
    rows, known = [], dict[str, float]()
    if "plant" in models:
        truth = models["plant"].installed
        known = dict(zip(truth.labels, map(float, truth.parameters), strict=True))
    for model, vessel in models.items():
        own = vessel.installed
        for label, value, bounds in zip(own.labels, own.parameters, own.bounds, strict=True):
            device, _, name = label.partition(".")
            error = identified.device_errors.get(label) if model == "identified" else None
            true = None if model == "plant" else known.get(label)
            rows.append(Coefficient(model, device, name, float(value), error, true, bounds.unit))
    return rows


def state_space_coefficients(identified: Identified) -> list[Coefficient]:
    """Return every matrix entry of a state-space model, as model `state_space`, term `A[1,2]`."""
    return [
        Coefficient(
            "state_space", "all", f"{name}[{','.join(str(k + 1) for k in index)}]", float(value),
            None, None, "",
        )
        for name in ("A", "B", "C", "D", "K", "F", "x0")
        if (matrix := getattr(identified.state_space, name, None)) is not None
        for index, value in np.ndenumerate(matrix)
    ]  # fmt: skip


def numbered(name: str, tables: Iterable[Vessel]) -> list[Coefficient]:
    """Return the non-zero coefficients of tables, as models `name_1`, `name_2` and so on."""
    return [row for i, each in enumerate(tables, 1) for row in _of_table(f"{name}_{i}", each)]
