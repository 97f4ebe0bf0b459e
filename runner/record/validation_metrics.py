"""Metrics of a model on the held-out part: force residual, coefficients and predictions."""

import numpy as np

from seatrial.models.errors import IdentificationError
from seatrial.models.findings import Finding
from seatrial.models.identification.problem import Identified, Problem, lack_of_fit
from seatrial.models.identification.validation import AHEAD, Ahead, prediction
from seatrial.models.recording.recording import Recording
from seatrial.models.simulation import metrics as measure
from seatrial.models.vessel.table import Vessel
from seatrial.runner.database.records import Metric
from seatrial.runner.record.metric_rows import metric, per_dof


def validation(
    held_out: Recording, nominal: Vessel, identified: Identified, truth: Vessel | None
) -> list[Metric]:
    """One-step force residuals on the held-out part, of every model, and what they show."""
    models = {"nominal": nominal, "identified": identified.model}
    if truth is not None:
        models["plant"] = truth
    forces = {"": "commanded"}
    if held_out.tau_filtered is not None:
        forces["_filtered"] = "filtered"
    dofs = held_out.dofs
    found: list[Metric] = []
    flags = np.zeros(len(dofs), dtype=bool)
    for suffix, force in forces.items():
        residuals = {name: lack_of_fit(held_out, model, force) for name, model in models.items()}
        squares = {name: measure.mean_square(e) for name, e in residuals.items()}
        for name, e in residuals.items():
            found += per_dof(f"force_mse{suffix}", "validation", name, dofs, squares[name])
            mae = measure.mean_absolute(e)
            found += per_dof(f"force_mae{suffix}", "validation", name, dofs, mae)
        if truth is not None:
            variance = np.var(held_out.force(force), axis=0)
            flags |= measure.below_true_model(squares["identified"], squares["plant"], variance)
    if truth is not None:
        found += per_dof("below_true_model", "validation", "identified", dofs, 1.0 * flags)
        found += _coefficient_errors(nominal, "nominal", truth)
        found += _coefficient_errors(identified.model, "identified", truth)
        own = truth.on(nominal.terms)
        found += _median_error(nominal, "nominal", own) + _median_error(
            identified.model, "identified", own
        )
    return found


def _coefficient_errors(model: Vessel, name: str, truth: Vessel) -> list[Metric]:
    """Largest relative error per degree of freedom over the coefficients that are not zero."""
    errors = measure.relative_errors(model.on(truth.terms).theta, truth.theta)
    known = ~np.isnan(errors)
    worst = np.where(known, errors, 0.0).max(axis=0, initial=0.0)
    return [
        metric("coefficient_error", "validation", name, dof, value)
        for dof, value, any_known in zip(
            truth.dofs, worst, np.atleast_1d(known.any(axis=0)), strict=True
        )
        if any_known
    ]


def _median_error(model: Vessel, name: str, truth: Vessel) -> list[Metric]:
    """Median relative error over the true coefficients of the vessel's own terms, wind's apart."""
    errors = measure.relative_errors(model.on(truth.terms).theta, truth.theta)
    known = errors[~np.isnan(errors)]
    middle = float(np.median(known)) if known.size else float("nan")
    return [metric("coefficient_error_median", "validation", name, "all", middle)]


UNKNOWN = Ahead(np.array(np.nan), float("nan"))  # of a model that cannot predict


def prediction_metrics(
    problem: Problem, identified: Identified, truth: Vessel | None
) -> tuple[list[Metric], list[Finding]]:
    """Root mean square error of pose and velocity on the held-out part, of every model.

    One step and ten steps after every measured state, and a free run. A model that cannot predict
    has empty figures and its reason as a diagnostic.
    """
    models = {"nominal": problem.nominal, "identified": identified.model}
    if truth is not None:
        models["plant"] = truth
    held_out, dofs = problem.validation, problem.validation.dofs
    found: list[Metric] = []
    reasons: list[Finding] = []
    for model, table in models.items():
        try:
            ready = prediction(table, held_out, problem.thruster)
            errors = {name: ready.ahead(steps) for name, steps in AHEAD.items()}
        except IdentificationError as error:
            reason = f"{model} model: {error}"
            reasons.append(Finding("no_prediction", "all", 1.0, label=reason))
            errors = dict.fromkeys(AHEAD, UNKNOWN)
        for name, (rmse, limited) in errors.items():
            halves = np.split(np.broadcast_to(rmse, 2 * len(dofs)), 2)
            for what, half in zip(("pose", "velocity"), halves, strict=True):
                found += per_dof(f"{what}_rmse_{name}", "validation", model, dofs, half)
            found.append(metric(f"limited_share_{name}", "validation", model, "all", limited))
    return found, reasons
