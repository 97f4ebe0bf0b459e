"""Validation metrics on the held-out part: force residuals, coefficients and predictions."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import IdentificationError
from seatrial.models.identification.calibration import bands
from seatrial.models.identification.problem import Identified, Problem, lack_of_fit, reference_force
from seatrial.models.identification.validation import (
    HORIZONS,
    Ahead,
    InertiaError,
    Prediction,
    combined,
    prediction,
    restart_length,
    scores,
)
from seatrial.models.recording.recording import Recording
from seatrial.models.simulation import metrics as measure
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel
from seatrial.runner.record.catalogue import PER_FILE, QUANTITIES
from seatrial.runner.record.rows import Metric, metric, per_dof
from seatrial.runner.record.vocabulary import OF_FILE, SAILED

BY_CHANCE = 0.5  # of the motion, by which free runs from equal states may differ


def per_file(problem: Problem, identified: Identified) -> list[Diagnostic]:
    """Compute errors on each file of the held-out part; i is the file, named by the label.

    A free run starts from the first state of the part of the file that is tested on, whose length
    is a diagnostic too. Nothing is computed unless there are several files.
    """
    diagnostics: list[Diagnostic] = []
    for i, (name, part) in enumerate(problem.validation.by_file().items()):
        alone = replace(problem, validation=part)
        rows = validation(part, problem.nominal, identified, None)
        rows += predictions(alone, identified, None).metrics
        duration = part.t[-1] - part.t[0]
        diagnostics.append(Diagnostic(f"{OF_FILE}duration", "all", duration, "s", i, 0, name))
        diagnostics += [
            Diagnostic(
                f"{OF_FILE}{row.name}", row.dof, row.value, row.unit, i,
                SAILED.index(row.model), f"{name}, {row.model} model",
            )
            for row in rows
            if row.name in PER_FILE and row.model in SAILED
        ]  # fmt: skip
    return diagnostics


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
            variance = np.var(reference_force(held_out, nominal, force), axis=0)
            flags |= measure.below_true_model(squares["identified"], squares["plant"], variance)
    if truth is not None:
        metrics += per_dof("below_true_model", "validation", "identified", dofs, 1.0 * flags)
        metrics += _coefficient_errors({"nominal": nominal, "identified": identified.model}, truth)
    return metrics


def _coefficient_errors(models: Mapping[str, Vessel], truth: Vessel) -> list[Metric]:
    """Compute relative errors of the non-zero coefficients of models beside the true one.

    For each degree of freedom the largest, and over all of them the median of the vessel's own,
    which are the nominal terms, without the wind's.
    """

    def errors(model: Vessel, true: Vessel) -> Array:
        return measure.relative_errors(model.on(true.terms).theta, true.theta)

    metrics = [
        metric("coefficient_error", "validation", name, dof, np.nanmax(by_term))
        for name, model in models.items()
        for dof, by_term in zip(truth.dofs, errors(model, truth).T, strict=True)
        if np.any(~np.isnan(by_term))
    ]
    own = truth.on(models["nominal"].terms)
    for name, model in models.items():
        of_terms = errors(model, own)
        known = of_terms[~np.isnan(of_terms)]
        median = np.median(known) if known.size else np.nan
        metrics.append(metric("coefficient_error_median", "validation", name, "all", median))
    return metrics


@dataclass(frozen=True, eq=False)
class Predictions:
    """Predictions of the held-out part: their metrics, what prevented them, and the free runs."""

    metrics: list[Metric]
    diagnostics: list[Diagnostic]
    free_runs: dict[str, Array]  # by model: pose and velocity (N, 2 n_dof); NaN where it diverges
    # by model and horizon [s]: pose and velocity (N, 2 n_dof); NaN where no prediction ends
    after: dict[tuple[str, float], Array]


def predictions(
    problem: Problem, identified: Identified, truth: Vessel | None, horizons_s: Sequence[float] = ()
) -> Predictions:
    """Compute errors and scores of the predictions of every model on the held-out part.

    A horizon over which a model diverges has its share of limited rates but no errors, nor has a
    model that cannot predict; the reason is returned as a diagnostic. The rows of `mean_motion` are
    those of a model that always predicts the mean of the measured motion.
    """
    models = {"nominal": problem.nominal, "identified": identified.model}
    if truth is not None:
        models["plant"] = truth
    metrics, diagnostics = list[Metric](), list[Diagnostic]()
    predicted = Predictions(metrics, diagnostics, {}, {})
    dofs = problem.validation.dofs
    spread, unknown = None, np.full(2 * len(dofs), np.nan)
    restart_s = restart_length(problem.nominal, problem.training)
    for model, table in models.items():
        try:
            predictor = prediction(table, problem.validation, problem.thruster, restart_s=restart_s)
        except IdentificationError as error:
            label = f"{model} model: {error}"
            diagnostics.append(Diagnostic("no_prediction", "all", 1.0, label=label))
            limited, held = (1.0, 0.0) if isinstance(error, InertiaError) else (np.nan, np.nan)
            for horizon in HORIZONS:
                metrics += _over(model, horizon, Ahead(unknown, limited, unknown), unknown, dofs)
            metrics.append(metric("held_free_run", "validation", model, "all", held))
            continue
        if spread is None:
            spread = predictor.mean_motion()
            for horizon in HORIZONS:
                metrics += _errors("mean_motion", horizon, spread, dofs)
        for horizon in HORIZONS:
            ahead = predictor.over(horizon)
            if ahead.diverged:
                ahead = ahead._replace(rmse=unknown, std=unknown)
            metrics += _over(model, horizon, ahead, spread, dofs)
        held = predictor.held_s()
        metrics.append(metric("held_free_run", "validation", model, "all", held))
        predicted.free_runs[model] = predictor.motion()
        if model == "identified":
            diagnostics += _chance(predictor, problem.validation)
        for seconds in horizons_s:
            predicted.after[model, seconds] = predictor.motion_after(seconds)
    return predicted


def _chance(predictor: Prediction, held_out: Recording) -> list[Diagnostic]:
    """Tell whether the noise of the first state decides the free run, so that no model is right."""
    noise = held_out.noise.deviation
    apart = predictor.sensitivity(np.concatenate([np.zeros_like(noise), noise]))
    if not np.any(apart > BY_CHANCE):
        return []
    k = int(np.argmax(apart))
    label = (
        f"free runs of the whole held-out part depend on their initial state, not on the model: "
        f"two whose initial states differ by the noise differ in {held_out.dofs[k]} by "
        f"{apart[k]:.2g} of the motion; compare predictions with restarts (velocity_rmse_restarts)"
    )
    return [Diagnostic("free_run_by_chance", held_out.dofs[k], float(apart[k]), label=label)]


def deviation(problem: Problem, identified: Identified) -> tuple[Array | None, list[Diagnostic]]:
    """Compute the standard deviation of measured minus identified in the free run.

    Returns:
        Of the pose and the velocity (N, 2 n_dof) on the held-out part, in SI units; None without a
        model error. And the reason why there is none for a model that has one.
    """
    try:
        found = bands(identified, problem.validation, problem.thruster)
    except IdentificationError:  # that it cannot predict is said by `predictions`
        return None, []
    if found is None or np.all(np.isfinite(found)):
        return found, []
    label = "no band: the identified model, or models drawn about it, diverge"
    return None, [Diagnostic("no_band", "all", 1.0, label=label)]


def _over(
    model: str, horizon: str, ahead: Ahead, spread: Array, dofs: tuple[str, ...]
) -> list[Metric]:
    """Rows of the predictions over one horizon: the limited share, the errors and the scores."""
    metrics = [metric(f"limited_share_{horizon}", "validation", model, "all", ahead.limited)]
    metrics += _errors(model, horizon, ahead.rmse, dofs)
    for name, score in scores(ahead, spread)._asdict().items():
        for quantity, half in zip(QUANTITIES, np.split(score, 2), strict=True):
            full = f"{quantity}_{name}_{horizon}"
            metrics += per_dof(full, "validation", model, dofs, half)
            metrics.append(metric(full, "validation", model, "all", combined(half)))
    return metrics


def _errors(model: str, horizon: str, rmse: Array, dofs: tuple[str, ...]) -> list[Metric]:
    return [
        row
        for quantity, half in zip(QUANTITIES, np.split(rmse, 2), strict=True)
        for row in per_dof(f"{quantity}_rmse_{horizon}", "validation", model, dofs, half)
    ]
