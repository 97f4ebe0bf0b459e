"""Deployment: tracking, step response and effort of missions, and what their design warns of."""

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError, Diverged
from seatrial.models.excitation.missions import Mission
from seatrial.models.identification.calibration import squared_accelerations
from seatrial.models.identification.problem import Identified
from seatrial.models.notation import FORCE_UNIT, PLANAR, POSE_UNIT
from seatrial.models.recording.recording import attitude_of
from seatrial.models.simulation import metrics as measure
from seatrial.models.simulation.statespace import StateSpace
from seatrial.models.simulation.voyage import Voyage
from seatrial.models.vessel.allocation import reached
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import wrap
from seatrial.models.vessel.table import Vessel
from seatrial.runner.configuration.config import Trial
from seatrial.runner.record.coefficient_rows import numbered
from seatrial.runner.record.own_metrics import own_rows
from seatrial.runner.record.rows import Metric, Results, metrics
from seatrial.runner.trials.berthing import berthing_results
from seatrial.runner.trials.checks import evaluated, skipped
from seatrial.runner.trials.closed_loop import (
    ControlDesign,
    SimulatedMission,
    Streams,
    TrialDiverged,
    prepare,
    wind_in_body,
)
from seatrial.runner.trials.time_series import deployment_series, is_allocated

log = logging.getLogger(__name__)
SAILED_AS_IDENTIFIED = "measured recording: the plant of the deployment is the identified model"
WITHHELD = "the identified model is not deployed: {}; deploy_unphysical=true deploys it"
UNREACHED = "unreached_share: the thrusters cannot produce {:.1%} of the commanded forces"
UNPHYSICAL = "unphysical"  # diagnostic: why a model is physically impossible
STAND_S = 30.0  # the vessel is expected to settle at a set-point that lasts this long [s]
LOW, HIGH = "tracking_low", "tracking_high"  # diagnostics: a 90 % interval of a tracking error
QUANTILES = (0.05, 0.95)
TRACKING_DRAWS = 40
ERRORS = ("e_pos_mae", "e_psi_mae")


def deploy(
    trial: Trial, seeds: Streams, nominal: Vessel, identified: Identified, truth: Vessel | None
) -> Results:
    """Simulate the evaluation with a controller built on the nominal and on the identified model.

    Both are simulated in the same weather; an identified model that is physically impossible is
    withheld. With `update`, a third simulation adapts the nominal model. After a measured recording
    the plant is the identified model, as the true one (`truth`) is not known. Raises TrialDiverged.
    """
    if (note := skipped(trial)) is not None:
        return Results(note=note)
    flaws = [each.label for each in identified.diagnostics if each.name == UNPHYSICAL]
    if withhold := bool(flaws) and not trial.deploy_unphysical:
        note = WITHHELD.format(flaws[0])
        log.warning(note)
    true = None
    if truth is None:
        if withhold:
            return Results(note=note)
        try:
            identified.model.plant_table()
        except ConfigurationError as error:
            log.warning("deployment is skipped: %s", error)
            return Results(note=f"measured recording: deployment is skipped: {error}")
        true, note = identified.model, SAILED_AS_IDENTIFIED
    controller, mission = trial.controller, evaluated(trial)
    assert controller is not None
    models: dict[str, Vessel | StateSpace] = {"nominal": nominal}
    if not withhold:
        linear = identified.control_model if controller.takes_state_space else None
        models["identified"] = identified.model if linear is None else linear
    if trial.update is not None:
        models["adaptive"] = nominal
    results, failure = Results(note=note), None
    for name, model in models.items():
        prepared = prepare(trial, seeds, model, mission, deployed=True, true=true)
        results += of_design(prepared.design, name)
        try:
            sailed = prepared.sail(adaptive=name == "adaptive")
        except Diverged as error:
            failure = Diverged(f"{name} model: {error}", error.time_s, error.quantity)
            continue
        results += of_voyage(trial, sailed, name) + berthing_results(mission, sailed, name)
        if name == "identified" and true is not None:
            intervals = tracking_intervals(trial, seeds, identified, mission, sailed)
            results += Results(diagnostics=intervals)
    if withhold:  # the numbers of the nominal model, without values
        missing = [replace(row, model="identified", value=None) for row in results.metrics
                   if (row.stage, row.model) == ("deployment", "nominal")]  # fmt: skip
        results += Results(missing)
    if failure is not None:
        raise TrialDiverged(failure, results)
    return results


def of_design(design: ControlDesign, model: str, where: str = "") -> Results:
    """Return the controller's diagnostics and the force that the weather needs.

    Warns of a closed loop that is unstable, and of limits that the weather exceeds; `where` begins
    the warnings.
    """
    diagnostics = [replace(each, label=model) for each in design.diagnostics]
    values, texts = dict[str, dict[str, float]](), list[str]()
    for each in design.diagnostics:
        if each.name == "spectral_radius" and each.value is not None:
            values.setdefault(each.name, {})[each.dof] = each.value
            if each.value >= 1.0:
                texts.append(
                    f"{model} model: the closed loop's spectral radius is {each.value:.4f}, "
                    f"expected less than 1: the loop is unstable on the controller's own model"
                )
    for i, (dof, needed) in enumerate(zip(design.dofs, map(float, design.needed), strict=True)):
        unit = FORCE_UNIT[dof]
        diagnostics.append(Diagnostic("needed_force", dof, needed, unit, label=model))
        if design.limits is not None:
            limit = design.limits[i]
            values.setdefault("infeasible_limits", {})[dof] = needed > limit
            if needed > limit:
                texts.append(
                    f"infeasible_limits: {dof} needs up to {needed:.3g} {unit} to stand still, "
                    f"the limit is {limit:.3g} {unit}"
                )
    rows = metrics("deployment", model, design.dofs, values)
    return Results(rows, diagnostics=[*diagnostics, *_warned(texts, where)])


def of_voyage(trial: Trial, sailed: SimulatedMission, model: str) -> Results:
    """How well a mission was tracked by a controller built on a model, and what that took."""
    voyage, adapter, share = sailed.voyage, sailed.adapter, unreached(sailed.voyage)
    results = Results(
        [
            *tracking_metrics(voyage, model, trial.sample_time_s),
            *response_metrics(sailed, model),
            *own_rows(trial.metrics, "of_voyage", model, voyage),
        ],
        diagnostics=[
            *_warned([f"{model} model: {UNREACHED.format(share)}"] if share else []),
            *(replace(finding, label=model) for finding in sailed.findings),
        ],
        series=[deployment_series(sailed, model)],
    )
    if adapter is not None:
        rows = numbered("adaptive", (model for _, model, _ in adapter.versions))
        results += Results(coefficients=rows, diagnostics=adapter.diagnostics())
    return results


def _warned(texts: Sequence[str], where: str = "") -> list[Diagnostic]:
    """Log warnings, and return them as diagnostics, to be stored with the run."""
    for text in texts:
        log.warning("%s%s", where, text)
    return [Diagnostic("warning", "all", None, label=text) for text in texts]


def tracking_metrics(voyage: Voyage, model: str, period_s: float) -> list[Metric]:
    """Compute tracking error, force and power of a mission, from the true pose.

    Angles are in degrees in `e_psi`; `period_s` is the sample time [s]. The commands of a vessel
    with inputs are no forces, and its reference is a pose alone: it has the errors of the pose.
    """
    log, power, values = voyage.log, _powers(voyage), dict[str, object]()
    errors = {"position": measure.position_error(log.eta_d, log.eta)}
    if voyage.dofs == PLANAR:
        errors["heading"] = measure.heading_error(log.eta_d, log.eta)
    if voyage.by_force:
        values = {
            "nu_mse": measure.mean_square(log.nu_d - log.nu),
            "nu_dot_mse": measure.mean_square(log.nu_dot_d - log.nu_dot),
            "tau_mean_abs": measure.mean_absolute(log.tau),
            "tau_fb_mean_abs": measure.mean_absolute(log.tau_fb),
            "power_mean": {dof: np.mean(each) for dof, each in power.items()},
            "iaew": {dof: measure.iaew(errors[dof], power[dof], period_s) for dof in power},
        }
        if (share := unreached(voyage)) is not None:
            values["unreached_share"] = share
    for name, (dof, error) in zip(("e_pos", "e_psi"), errors.items(), strict=False):
        shown = np.degrees(error) if dof == "heading" else error
        values[f"{name}_mae"] = {dof: measure.mean_absolute(shown)}
        values[f"{name}_mse"] = {dof: measure.mean_square(shown)}
    return metrics("deployment", model, voyage.dofs, values)


def response_metrics(sailed: SimulatedMission, model: str) -> list[Metric]:
    """Compute error, step response and effort of every axis, energy, failures and time per step."""
    voyage, design, period_s = sailed.voyage, sailed.design, sailed.period_s
    log, dofs = voyage.log, voyage.dofs
    error = _in_degrees(log.eta_d - log.eta, dofs)
    values: dict[str, object] = {
        "error_mae": measure.mean_absolute(error),
        "error_mse": measure.mean_square(error),
        "iae": measure.integral_absolute_error(error, period_s),
        "itae": measure.integral_time_absolute_error(error, log.setpoint, period_s),
        "failures": sailed.failures,
        "held_commands": np.sum(np.any(log.held != 0.0, axis=1)),
    }
    if stretches := measure.stands(log.setpoint, round(STAND_S / period_s)):
        off, ahead = _in_degrees(log.setpoint - log.eta, dofs), design.ahead
        values["steady_state_error"] = measure.steady_state_error(off, stretches, period_s, ahead)
        steps = measure.step_responses(log.setpoint, log.eta, stretches, period_s, ahead)
        if any(np.any(~np.isnan(by_dof)) for by_dof in steps.values()):
            values |= steps
    if voyage.by_force:
        values["tau_max_abs"] = np.max(np.abs(log.tau), axis=0)
        values["tau_rms"] = measure.root_mean_square(log.tau)
        values["tau_tv"] = measure.total_variation(log.tau)
        power = _powers(voyage).items()
        values["energy"] = {dof: measure.energy(each, period_s) for dof, each in power}
    if design.limits is not None:
        values["limit_hits"] = measure.hits(log.tau, np.array(design.limits))
    if len(voyage.step_times):
        single = len(voyage.step_times) == len(voyage.t)  # else blocks of instants
        microseconds = 1e6 * voyage.step_times[:: design.every if single else 1]
        values["step_time_median"] = np.median(microseconds)
        values["step_time_p99"] = np.percentile(microseconds, 99)
    return metrics("deployment", model, dofs, values)


def _in_degrees(error: Array, dofs: Sequence[str]) -> Array:
    """Return the pose error with angles in degrees and the heading wrapped; shape (N, n_dof)."""
    wrapped = np.array(error)
    if "yaw" in dofs:
        wrapped[:, dofs.index("yaw")] = wrap(wrapped[:, dofs.index("yaw")])
    scale = [1.0 if POSE_UNIT[dof] == "m" else 180.0 / np.pi for dof in dofs]
    return np.asarray(wrapped * np.array(scale))


def _powers(voyage: Voyage) -> dict[str, Array]:
    """Return the power [W] in the plane, and about the down axis; none without forces."""
    if not voyage.by_force:
        return {}
    powers = {"position": measure.position_power(voyage.log.tau, voyage.log.nu)}
    if voyage.dofs == PLANAR:
        powers["heading"] = measure.heading_power(voyage.log.tau, voyage.log.nu)
    return powers


def unreached(voyage: Voyage) -> float | None:
    """Compute the share of the commands that the thrusters could not produce.

    Those of devices are shares at rest. None if there is no thruster allocation.
    """
    log = voyage.log
    if voyage.allocation is not None:
        return float(np.mean(~voyage.allocation.forces().allocate(log.tau, voyage.dofs).reached))
    return float(np.mean(~reached(log.tau, log.applied))) if is_allocated(voyage) else None


def tracking_intervals(
    trial: Trial, seeds: Streams, identified: Identified, mission: Mission, own: SimulatedMission
) -> list[Diagnostic]:
    """Return the bounds of the errors of `own`, the deployment of the identified model as plant.

    Models and accelerations are drawn from its distribution (`model_error`) as plants under the
    same controller, which was built on the identified model, in the same weather. The deviations
    are drawn at their whole size: a loop that holds the vessel near its reference bounds them, and
    what an acceleration adds to a mean absolute error is not proportional to it.

    Empty without a distribution. A controller that plans ahead takes too long for draws: it has
    the diagnostic `no_tracking_interval`, as has one whose drawn plants diverge.
    """
    refusal = Diagnostic("no_tracking_interval", "all", 1.0)
    if identified.spread is None:
        return []
    if own.design.ahead:
        reason = "the controller plans ahead, which takes too long for drawn plants"
        return [replace(refusal, label=reason)]
    log, error, wind = own.voyage.log, identified.model_error, wind_in_body(own.voyage)
    attitude = attitude_of(own.voyage.dofs, log.eta)
    rho2 = squared_accelerations(identified.model, log.nu, attitude, log.tau_actual, wind)
    values: dict[tuple[str, str, str], list[float]] = {}
    for i, plant in enumerate(identified.draws(TRACKING_DRAWS)):
        try:
            prepared = prepare(trial, seeds, identified.model, mission, deployed=True, true=plant)
            if error is not None:
                process = error.accelerations(rho2, own.period_s, np.random.default_rng(i))
                if len(prepared.weather.process):
                    process = process + prepared.weather.process
                prepared = replace(prepared, weather=prepared.weather._replace(process=process))
            rows = tracking_metrics(prepared.sail().voyage, "identified", own.period_s)
        except (ConfigurationError, Diverged):
            continue
        for row in rows:
            if row.name in ERRORS and row.value is not None:
                values.setdefault((row.name, row.dof, row.unit), []).append(row.value)
    if any(len(each) < 0.9 * TRACKING_DRAWS for each in values.values()) or not values:
        return [replace(refusal, label="more than a tenth of the drawn plants diverge")]
    return [
        Diagnostic(name, dof, float(bound), unit, label=error_name)
        for (error_name, dof, unit), each in values.items()
        for name, bound in zip((LOW, HIGH), np.quantile(each, QUANTILES), strict=True)
    ]
