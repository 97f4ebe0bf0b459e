"""Deployment: tracking, step response and effort of missions, and what their design warns of."""

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from seatrial.models.control.controller import Model
from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError, Diverged
from seatrial.models.excitation.missions import Mission
from seatrial.models.identification.calibration import squared_accelerations
from seatrial.models.identification.problem import Identified
from seatrial.models.notation import FORCE_UNIT, PLANAR, POSE_UNIT
from seatrial.models.recording.recording import attitude_of
from seatrial.models.simulation import metrics as measure
from seatrial.models.simulation.voyage import Voyage
from seatrial.models.vessel.allocation import reached
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import wrap
from seatrial.models.vessel.table import Vessel
from seatrial.runner.configuration.config import Trial
from seatrial.runner.record.coefficient_rows import numbered
from seatrial.runner.record.own_metrics import own_rows
from seatrial.runner.record.rows import Metric, Results, metrics
from seatrial.runner.record.vocabulary import UNPHYSICAL
from seatrial.runner.trials.berthing import berthing_results
from seatrial.runner.trials.checks import evaluated, skipped
from seatrial.runner.trials.closed_loop import (
    ControlDesign,
    SimulatedMission,
    Streams,
    TrialDiverged,
    deployment_series,
    is_allocated,
    prepare,
    warn,
    wind_in_body,
)

log = logging.getLogger(__name__)
SAILED_AS_IDENTIFIED = "measured recording: the plant of the deployment is the identified model"
WITHHELD = "the identified model is not deployed: {}; deploy_unphysical=true deploys it"
UNREACHED = "unreached_share: the thrusters cannot produce {:.1%} of the commanded forces"
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
    true = identified.model if truth is None else None
    flaws = [each.label for each in identified.diagnostics if each.name == UNPHYSICAL]
    if withhold := bool(flaws) and not trial.deploy_unphysical:
        note = WITHHELD.format(flaws[0])
        log.warning(note)
        if true is not None:
            return Results(note=note)
    elif true is not None:
        note = SAILED_AS_IDENTIFIED
        try:
            true.plant_table()
        except ConfigurationError as error:
            log.warning(note := f"measured recording: deployment is skipped: {error}")
            return Results(note=note)
    controller, mission = trial.controller, evaluated(trial)
    assert controller is not None
    models: dict[str, Model] = {"nominal": nominal}
    if not withhold:
        linear = identified.control_model if controller.takes_state_space else None
        models["identified"] = identified.model if linear is None else linear
    if trial.update is not None:
        models["adaptive"] = nominal
    results, failure, last = Results(note=note), None, None
    for name, model in models.items():
        prepared = prepare(trial, seeds, model, mission, deployed=True, true=true)
        results += of_design(prepared.design, name)
        try:
            if name == "adaptive" or model is not last:  # else the voyage is the same
                sailed = prepared.sail(trial.update if name == "adaptive" else None)
                last = model
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
    dofs, needed = design.dofs, dict(zip(design.dofs, map(float, design.needed), strict=True))
    limits = {} if design.limits is None else dict(zip(dofs, design.limits, strict=True))
    of_loop = (each for each in design.diagnostics if each.name == "spectral_radius")
    radii = {each.dof: each.value for each in of_loop if each.value is not None}
    exceeded = {dof: needed[dof] > limit for dof, limit in limits.items()}
    texts = [
        f"{model} model: the closed loop's spectral radius is {radius:.4f}, expected less than 1: "
        "the loop is unstable on the controller's own model"
        for radius in radii.values()
        if radius >= 1.0
    ]
    texts += [
        f"infeasible_limits: {dof} needs up to {needed[dof]:.3g} {FORCE_UNIT[dof]} to stand still, "
        f"the limit is {limits[dof]:.3g} {FORCE_UNIT[dof]}"
        for dof in dofs
        if exceeded.get(dof)
    ]
    diagnostics = [
        *(replace(each, label=model) for each in design.diagnostics),
        *(Diagnostic("needed_force", d, needed[d], FORCE_UNIT[d], label=model) for d in dofs),
        *warn(f"{where}{{}}", texts),
    ]
    values = {"spectral_radius": radii, "infeasible_limits": exceeded}
    return Results(metrics("deployment", model, dofs, values), diagnostics=diagnostics)


def of_voyage(trial: Trial, sailed: SimulatedMission, model: str) -> Results:
    """How well a mission was tracked by a controller built on a model, and what that took."""
    voyage, adapter, share = sailed.voyage, sailed.adapter, unreached(sailed.voyage)
    results = Results(
        [*mission_metrics(sailed, model), *own_rows(trial.metrics, "of_voyage", model, voyage)],
        diagnostics=[
            *warn("{}", [f"{model} model: {UNREACHED.format(share)}"] if share else []),
            *(replace(finding, label=model) for finding in sailed.findings),
        ],
        series=[deployment_series(sailed, model)],
    )
    if adapter is not None:
        rows = numbered("adaptive", (model for _, model, _ in adapter.versions))
        results += Results(coefficients=rows, diagnostics=adapter.diagnostics())
    return results


def mission_metrics(sailed: SimulatedMission, model: str) -> list[Metric]:
    """Compute how well a mission was tracked, from the true pose, and what that took.

    Angles are in degrees, but for those in `iaew`. The commands of a vessel with inputs are no
    forces, and its reference is a pose alone: it has the errors of the pose.
    """
    voyage, period_s, ahead = sailed.voyage, sailed.period_s, sailed.design.ahead
    log, dofs, limits = voyage.log, voyage.dofs, sailed.design.limits
    off = {"position": measure.position_error(log.eta_d, log.eta)}
    error, power = _in_degrees(log.eta_d - log.eta, dofs), dict[str, Array]()
    values: dict[str, object] = {
        "error_mae": measure.mean_absolute(error),
        "error_mse": measure.mean_square(error),
        "iae": measure.integral_absolute_error(error, period_s),
        "itae": measure.integral_time_absolute_error(error, log.setpoint, period_s),
        "e_pos_mae": {"position": np.mean(off["position"])},
        "e_pos_mse": {"position": measure.mean_square(off["position"])},
        "failures": sailed.failures,
        "held_commands": np.sum(np.any(log.held != 0.0, axis=1)),
    }
    if voyage.by_force:
        power["position"] = measure.position_power(log.tau, log.nu)
    if dofs == PLANAR:
        off["heading"] = measure.heading_error(log.eta_d, log.eta)
        values["e_psi_mae"] = {"heading": measure.mean_absolute(np.degrees(off["heading"]))}
        values["e_psi_mse"] = {"heading": measure.mean_square(np.degrees(off["heading"]))}
        if voyage.by_force:
            power["heading"] = measure.heading_power(log.tau, log.nu)
    if stretches := measure.stands(log.setpoint, round(STAND_S / period_s)):
        away = _in_degrees(log.setpoint - log.eta, dofs)
        values["steady_state_error"] = measure.steady_state_error(away, stretches, period_s, ahead)
        steps = measure.step_responses(log.setpoint, log.eta, stretches, period_s, ahead)
        if any(np.any(~np.isnan(by_dof)) for by_dof in steps.values()):
            values |= steps
    if voyage.by_force:
        values |= {
            "nu_mse": measure.mean_square(log.nu_d - log.nu),
            "nu_dot_mse": measure.mean_square(log.nu_dot_d - log.nu_dot),
            "tau_mean_abs": measure.mean_absolute(log.tau),
            "tau_fb_mean_abs": measure.mean_absolute(log.tau_fb),
            "tau_max_abs": np.max(np.abs(log.tau), axis=0),
            "tau_rms": measure.root_mean_square(log.tau),
            "tau_tv": measure.total_variation(log.tau),
            "power_mean": {dof: np.mean(each) for dof, each in power.items()},
            "energy": {dof: measure.energy(each, period_s) for dof, each in power.items()},
            "iaew": {dof: measure.iaew(off[dof], power[dof], period_s) for dof in power},
        }
        if (share := unreached(voyage)) is not None:
            values["unreached_share"] = share
    if limits is not None:
        values["limit_hits"] = measure.hits(log.tau, np.array(limits))
    if len(voyage.step_times):
        single = len(voyage.step_times) == len(voyage.t)  # else blocks of instants
        microseconds = 1e6 * voyage.step_times[:: sailed.design.every if single else 1]
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
    if identified.spread is None:
        return []
    refusal = Diagnostic("no_tracking_interval", "all", 1.0)
    if own.design.ahead:
        label = "the controller plans ahead, which takes too long for drawn plants"
        return [replace(refusal, label=label)]
    log, error, wind = own.voyage.log, identified.model_error, wind_in_body(own.voyage)
    attitude = attitude_of(own.voyage.dofs, log.eta)
    rho2 = squared_accelerations(identified.model, log.nu, attitude, log.tau_actual, wind)
    runs: list[list[Metric]] = []
    for i, plant in enumerate(identified.draws(TRACKING_DRAWS)):
        try:
            prepared = prepare(trial, seeds, identified.model, mission, deployed=True, true=plant)
            if error is not None:
                process = error.accelerations(rho2, own.period_s, np.random.default_rng(i))
                if len(prepared.weather.process):
                    process = process + prepared.weather.process
                prepared = replace(prepared, weather=prepared.weather._replace(process=process))
            rows = mission_metrics(prepared.sail(), "identified")
        except (ConfigurationError, Diverged):
            continue
        runs.append([row for row in rows if row.name in ERRORS])
    if len(runs) < 0.9 * TRACKING_DRAWS:
        return [replace(refusal, label="more than a tenth of the drawn plants diverge")]
    values = np.array([[row.value for row in rows] for rows in runs], dtype=np.float64)
    return [
        Diagnostic(name, row.dof, float(bound), row.unit, label=row.name)
        for row, bounds in zip(runs[0], np.quantile(values, QUANTILES, axis=0).T, strict=True)
        for name, bound in zip((LOW, HIGH), bounds, strict=True)
    ]
