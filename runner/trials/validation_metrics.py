"""Validation on the held-out part: force residuals, coefficients, predictions and manoeuvres."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import IdentificationError
from seatrial.models.identification import validation
from seatrial.models.identification.calibration import bands
from seatrial.models.identification.problem import Identified, Problem, lack_of_fit, reference_force
from seatrial.models.recording.recorded_file import RecordedFile
from seatrial.models.recording.recording import Recording
from seatrial.models.simulation import metrics as measure
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel
from seatrial.runner.configuration.config import Trial
from seatrial.runner.record.catalogue import HORIZONS, PER_FILE, QUANTITIES
from seatrial.runner.record.own_metrics import own_rows
from seatrial.runner.record.rows import Metric, Results, metrics
from seatrial.runner.record.vocabulary import IDENTIFIED_STD, OF_FILE, SAILED
from seatrial.runner.trials import manoeuvre_results
from seatrial.runner.trials.closed_loop import SeriesColumns, warn

BY_CHANCE = 0.5  # of the motion, by which free runs from equal states may differ
NO_BAND = "no band: the identified model, or models drawn about it, diverge"


def validate(
    trial: Trial, problem: Problem, identified: Identified, truth: Vessel | None
) -> Results:
    """Predict what was not trained on: accelerations, free runs, and manoeuvres."""
    tested = problem.validation
    models = {"nominal": problem.nominal, "identified": identified.model}
    diagnostics = _per_file(problem, models)
    if isinstance(file := trial.excitation, RecordedFile):
        diagnostics += manoeuvre_results.recorded_manoeuvres(
            problem, identified, trial.vessel.scales.length_m, file.manoeuvre
        )
    if truth is not None:
        models["plant"] = truth
    band, no_band = None, list[Diagnostic]()
    with suppress(IdentificationError):  # that it cannot predict is said by `predictions`
        band = bands(identified, tested, problem.thruster)
    if band is not None and not np.all(np.isfinite(band)):
        band, no_band = None, [Diagnostic("no_band", "all", 1.0, label=NO_BAND)]
    results = Results(residuals(tested, models))
    results += predictions(problem, models, trial.horizons_s or (), band)
    results += Results(diagnostics=no_band)
    warn("prediction: {}", (each.label for each in results.diagnostics))
    for name, model in models.items():
        results += Results(own_rows(trial.metrics, "of_model", name, tested, model))
    results += Results(diagnostics=diagnostics)
    return results + Results(manoeuvre_results.own_manoeuvres(trial, models))


def _per_file(problem: Problem, models: Mapping[str, Vessel]) -> list[Diagnostic]:
    """Compute errors on each file of the held-out part; i is the file, named by the label.

    A free run starts from the first state of the part of the file that is tested on, whose length
    is a diagnostic too. Nothing is computed unless there are several files.
    """
    diagnostics: list[Diagnostic] = []
    for i, (name, part) in enumerate(problem.validation.by_file().items()):
        duration = part.t[-1] - part.t[0]
        diagnostics.append(Diagnostic(f"{OF_FILE}duration", "all", duration, "s", i, 0, name))
        alone = replace(problem, validation=part)
        diagnostics += [
            Diagnostic(
                f"{OF_FILE}{row.name}", row.dof, row.value, row.unit, i,
                SAILED.index(row.model), f"{name}, {row.model} model",
            )
            for row in [*residuals(part, models), *predictions(alone, models).metrics]
            if row.name in PER_FILE and row.model in SAILED
        ]  # fmt: skip
    return diagnostics


def residuals(held_out: Recording, models: Mapping[str, Vessel]) -> list[Metric]:
    """Compute the force residuals of every model, and its coefficient errors beside the plant.

    A model whose force error is below the true plant's is flagged as `below_true_model`. The median
    error of the coefficients is over the vessel's own, which are the nominal terms, without the
    wind's.
    """
    nominal, truth, dofs = models["nominal"], models.get("plant"), held_out.dofs
    rows: list[Metric] = []
    below = np.zeros(len(dofs), dtype=bool)
    for suffix, force in (("", "commanded"), ("_filtered", "filtered")):
        if suffix and held_out.tau_filtered is None:
            continue
        squares = {}
        for name, model in models.items():
            off = lack_of_fit(held_out, model, force)
            squares[name] = measure.mean_square(off)
            values = {"force_mse": squares[name], "force_mae": measure.mean_absolute(off)}
            named = {f"{key}{suffix}": value for key, value in values.items()}
            rows += metrics("validation", name, dofs, named)
        if truth is not None:
            variance = np.var(reference_force(held_out, nominal, force), axis=0)
            below |= measure.below_true_model(squares["identified"], squares["plant"], variance)
    if truth is None:
        return rows
    rows += metrics("validation", "identified", dofs, {"below_true_model": 1.0 * below})
    for name in SAILED:
        every, own = (
            measure.relative_errors(models[name].on(true.terms).theta, true.theta)
            for true in (truth, truth.on(nominal.terms))
        )
        by_dof = zip(dofs, every.T, strict=True)
        own = own[~np.isnan(own)]
        errors = {
            "coefficient_error": {dof: np.nanmax(e) for dof, e in by_dof if not np.isnan(e).all()},
            "coefficient_error_median": np.median(own) if own.size else np.nan,
        }
        rows += metrics("validation", name, dofs, errors)
    return rows


def predictions(
    problem: Problem, models: Mapping[str, Vessel], horizons_s: Sequence[float] = (),
    band: Array | None = None,
) -> Results:  # fmt: skip
    """Compute errors and scores of the predictions of every model on the held-out part.

    A horizon over which a model diverges has its share of limited rates but no errors, nor has a
    model that cannot predict; the reason is a diagnostic. The rows of `mean_motion` are those of a
    model that always predicts the mean of the measured motion.

    The series has the held-out motion and its predictions, NaN where they diverge. `start` is 1 at
    the measured states from which the free runs begin. `surge` is the measured velocity,
    `surge_identified` that of the free run, `surge_identified_10s` that predicted from the state
    measured 10 s before; likewise `x` and `x_identified`. `surge_identified_std` is the `band`, the
    standard deviation of the measured velocity about that of the free run.
    """
    held_out, thruster = problem.validation, problem.thruster
    columns = SeriesColumns(held_out.dofs, held_out.t)
    motion = {**columns.pose, **columns.speed}
    columns.add(held_out.piece_starts, {"start": ""})
    columns.add(np.hstack([held_out.eta, held_out.nu]), motion)
    rows, diagnostics = list[Metric](), list[Diagnostic]()
    unknown = np.full(len(motion), np.nan)
    moved = unknown
    restart_s = validation.restart_length(problem.nominal, problem.training)
    for name, model in models.items():
        try:
            run = validation.prediction(model, held_out, thruster, restart_s=restart_s)
        except IdentificationError as error:
            label = f"{name} model: {error}"
            diagnostics.append(Diagnostic("no_prediction", "all", 1.0, label=label))
            is_limited = isinstance(error, validation.InertiaError)
            limited, held = (1.0, 0.0) if is_limited else (np.nan, np.nan)
            over = dict.fromkeys(HORIZONS, validation.Ahead(unknown, limited, unknown))
        else:
            over, held = {horizon: run.over(horizon) for horizon in HORIZONS}, run.held_s()
            columns.add(run.motion(), motion, f"{{}}_{name}")
            for seconds in horizons_s:
                columns.add(run.motion_after(seconds), motion, f"{{}}_{name}_{seconds:g}s")
            if name == "identified":
                diagnostics += _chance(run, held_out)
            if moved is unknown:
                moved = run.mean_motion()
                errors = dict(each for h in HORIZONS for each in _halves(f"rmse_{h}", moved))
                rows += metrics("validation", "mean_motion", held_out.dofs, errors)
        values: dict[str, object] = {"held_free_run": held}
        for horizon, ahead in over.items():
            values[f"limited_share_{horizon}"] = ahead.limited
            if ahead.diverged:
                ahead = ahead._replace(rmse=unknown, std=unknown)
            values |= _halves(f"rmse_{horizon}", ahead.rmse)
            for score, each in validation.scores(ahead, moved)._asdict().items():
                for key, half in _halves(f"{score}_{horizon}", each):
                    whole = {"all": validation.combined(half)}
                    values[key] = {**dict(zip(held_out.dofs, half, strict=True)), **whole}
        rows += metrics("validation", name, held_out.dofs, values)
    columns.add(band, motion, f"{{}}_{IDENTIFIED_STD}")
    return Results(rows, diagnostics=diagnostics, series=[columns.series("prediction")])


def _halves(name: str, values: Array) -> list[tuple[str, Array]]:
    """Name the halves of an array of pose and velocity (2 n_dof,)."""
    halves = zip(QUANTITIES, np.split(values, 2), strict=True)
    return [(f"{quantity}_{name}", half) for quantity, half in halves]


def _chance(predictor: validation.Prediction, held_out: Recording) -> list[Diagnostic]:
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
