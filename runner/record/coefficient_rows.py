"""Coefficients of a trial as rows of the logbook, and vessels built from stored rows."""

from collections.abc import Iterable, Mapping

import numpy as np

from seatrial.models.identification.problem import Identified
from seatrial.models.notation import DOFS
from seatrial.models.vessel import basis
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
    return Vessel(name, dofs, basis.terms(names), np.array(theta))


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

    The parameters of devices follow, where they were identified, as `dof` the name of the device.
    """
    truths = {
        "nominal": truth,
        "residual": None if truth is None else truth - nominal,
        "identified": truth,
        "plant": None,
    }
    tables = {"nominal": nominal, "residual": identified.residual, "identified": identified.model}
    if truth is not None:
        tables["plant"] = truth
    residual, deviations = identified.residual, identified.std_error
    errors = {
        (term, dof): float(deviations[i, j])
        for i, term in enumerate(residual.terms)
        for j, dof in enumerate(residual.dofs)
        if deviations is not None and np.isfinite(deviations[i, j])
    }
    rows = []
    for model, table in tables.items():
        true = truths[model]
        union = table if true is None or model == "nominal" else (0.0 * true) + table
        for term, values in zip(union.terms, union.theta, strict=True):
            for dof, value in zip(union.dofs, values, strict=True):
                error = errors.get((term, dof)) if model in ("residual", "identified") else None
                true_value = None if true is None else true.coefficient(dof, term.name)
                if value or error is not None or true_value:
                    unit = coefficient_unit(term, dof)
                    rows.append(
                        Coefficient(model, dof, term.name, float(value), error, true_value, unit)
                    )
    models = {name: table for name, table in tables.items() if name != "residual"}
    return rows + _device_rows(models, identified, truth)


def _device_rows(
    models: Mapping[str, Vessel], identified: Identified, truth: Vessel | None
) -> list[Coefficient]:
    """Return the parameters of devices of several models, if they were identified."""
    if not identified.device_errors and same_devices(models["nominal"], identified.model):
        return []
    rows = []
    for model, vessel in models.items():
        own = vessel.installed
        for label, value, bounds in zip(own.labels, own.parameters, own.bounds, strict=True):
            device, _, name = label.partition(".")
            error = identified.device_errors.get(label) if model == "identified" else None
            true = None
            if truth is not None and model != "plant" and label in truth.installed.labels:
                true = float(truth.installed.parameters[truth.installed.labels.index(label)])
            rows.append(Coefficient(model, device, name, float(value), error, true, bounds.unit))
    return rows


def same_devices(first: Vessel, second: Vessel) -> bool:
    """Return whether two models have the same parameters of devices."""
    return np.array_equal(first.installed.parameters, second.installed.parameters)


def state_space_coefficients(identified: Identified) -> list[Coefficient]:
    """Return every matrix entry of a state-space model, as model `state_space`, term `A[1,2]`."""
    model = identified.state_space
    if model is None:
        return []
    matrices = {
        "A": model.A, "B": model.B, "C": model.C, "D": model.D, "K": model.K, "F": model.F,
        "x0": model.x0,
    }  # fmt: skip
    return [
        Coefficient(
            "state_space", "all", f"{name}[{','.join(str(k + 1) for k in index)}]", float(value),
            None, None, "",
        )
        for name, matrix in matrices.items()
        if matrix is not None
        for index, value in np.ndenumerate(matrix)
    ]  # fmt: skip


def table_coefficients(tables: Mapping[str, Vessel]) -> list[Coefficient]:
    """Return the non-zero coefficients of several tables, which are keyed by model name."""
    return [
        Coefficient(model, dof, term.name, float(value), None, None, coefficient_unit(term, dof))
        for model, table in tables.items()
        for term, row in zip(table.terms, table.theta, strict=True)
        for dof, value in zip(table.dofs, row, strict=True)
        if value
    ]


def numbered(name: str, tables: Iterable[Vessel]) -> dict[str, Vessel]:
    """Key the tables by `name_1`, `name_2` and so on."""
    return {f"{name}_{i}": table for i, table in enumerate(tables, start=1)}
