"""Validation metrics on the held-out part: force residuals, coefficients and predictions."""

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
    """Compute the force residuals of every model on the held-out part, and the coefficient errors.

    A model whose force error is below the true plant's is flagged as `below_true_model`.
    """
    models = {"nominal": nominal, "identified": identified.model}
    if truth is not None:
        models["plant"] = truth
    forces = {"": "commanded"}
    if held_out.tau_filtered is not None:
        forces["_filtered"] = "filtered"
    dofs = held_out.dofs
    metrics: list[Metric] = []
    flags = np.zeros(len(dofs), dtype=bool)
    for suffix, force in forces.items():
        residuals = {name: lack_of_fit(held_out, model, force) for name, model in models.items()}
        squares = {name: measure.mean_square(e) for name, e in residuals.items()}
        for name, e in residuals.items():
            metrics += per_dof(f"force_mse{suffix}", "validation", name, dofs, squares[name])
            mae = measure.mean_absolute(e)
            metrics += per_dof(f"force_mae{suffix}", "validation", name, dofs, mae)
        if truth is not None:
            variance = np.var(held_out.force(force), axis=0)
            flags |= measure.below_true_model(squares["identified"], squares["plant"], variance)
    if truth is not None:
        metrics += per_dof("below_true_model", "validation", "identified", dofs, 1.0 * flags)
        metrics += _coefficient_errors(nominal, "nominal", truth)
        metrics += _coefficient_errors(identified.model, "identified", truth)
        own = truth.on(nominal.terms)
        metrics += _median_error(nominal, "nominal", own) + _median_error(
            identified.model, "identified", own
        )
    return metrics


def _coefficient_errors(model: Vessel, name: str, truth: Vessel) -> list[Metric]:
    """Compute the largest relative error of the non-zero coefficients per degree of freedom."""
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
    """Compute the median relative error of the vessel's coefficients, without the wind's."""
    errors = measure.relative_errors(model.on(truth.terms).theta, truth.theta)
    known = errors[~np.isnan(errors)]
    median = float(np.median(known)) if known.size else float("nan")
    return [metric("coefficient_error_median", "validation", name, "all", median)]


UNKNOWN = Ahead(np.array(np.nan), float("nan"))  # for a model that cannot predict


def prediction_metrics(
    problem: Problem, identified: Identified, truth: Vessel | None
) -> tuple[list[Metric], list[Finding]]:
    """Compute the RMSE of pose and velocity of every model on the held-out part.

    The predictions start at every measured state and last one step and ten steps; a free run
    starts at the first state only. For a model that cannot predict, the metrics are NaN and the
    reason is returned as a finding.
    """
    models = {"nominal": problem.nominal, "identified": identified.model}
    if truth is not None:
        models["plant"] = truth
    held_out, dofs = problem.validation, problem.validation.dofs
    metrics: list[Metric] = []
    reasons: list[Finding] = []
    for model, table in models.items():
        try:
            predictor = prediction(table, held_out, problem.thruster)
            errors = {name: predictor.ahead(steps) for name, steps in AHEAD.items()}
        except IdentificationError as error:
            reason = f"{model} model: {error}"
            reasons.append(Finding("no_prediction", "all", 1.0, label=reason))
            errors = dict.fromkeys(AHEAD, UNKNOWN)
        for name, (rmse, limited) in errors.items():
            halves = np.split(np.broadcast_to(rmse, 2 * len(dofs)), 2)
            for quantity, half in zip(("pose", "velocity"), halves, strict=True):
                metrics += per_dof(f"{quantity}_rmse_{name}", "validation", model, dofs, half)
            metrics.append(metric(f"limited_share_{name}", "validation", model, "all", limited))
    return metrics, reasons
