"""Deployment metrics: tracking, step response and control effort, and warnings of the design."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.notation import FORCE_UNIT, PLANAR, POSE_UNIT
from seatrial.models.simulation import metrics as measure
from seatrial.models.simulation.voyage import Voyage
from seatrial.models.vessel.allocation import reached
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import wrap
from seatrial.runner.record.rows import Metric, Results, metric, per_dof
from seatrial.runner.record.vocabulary import Stage
from seatrial.runner.trials.closed_loop import ControlDesign, SimulatedMission

STAND_S = 30.0  # the vessel is expected to settle at a set-point that lasts this long [s]


def of_design(design: ControlDesign, model: str) -> tuple[Results, list[str]]:
    """Return the controller's diagnostics and the force that the weather needs; and warnings.

    They warn of a closed loop that is unstable, and of limits that the weather exceeds.
    """
    radii = [
        (one.dof, one.value)
        for one in design.diagnostics
        if one.name == "spectral_radius" and one.value is not None
    ]
    warnings = [
        f"{model} model: the closed loop's spectral radius is {radius:.4f}, "
        f"expected less than 1: the loop is unstable on the controller's own model"
        for _, radius in radii
        if radius >= 1.0
    ]
    metrics = [metric("spectral_radius", "deployment", model, dof, value) for dof, value in radii]
    diagnostics = [
        Diagnostic(one.name, one.dof, one.value, one.unit, label=model)
        for one in design.diagnostics
    ]
    for i, (dof, needed) in enumerate(zip(design.dofs, map(float, design.needed), strict=True)):
        unit = FORCE_UNIT[dof]
        diagnostics.append(Diagnostic("needed_force", dof, needed, unit, label=model))
        if design.limits is not None:
            limit = design.limits[i]
            metrics.append(metric("infeasible_limits", "deployment", model, dof, needed > limit))
            if needed > limit:
                warnings.append(
                    f"infeasible_limits: {dof} needs up to {needed:.3g} {unit} to stand still, "
                    f"the limit is {limit:.3g} {unit}"
                )
    return Results(metrics, diagnostics=[*diagnostics, *warning_rows(warnings)]), warnings


def withheld(rows: Sequence[Metric]) -> list[Metric]:
    """Return the numbers of an identified model that is not deployed: those of the nominal one."""
    nominal = [row for row in rows if (row.stage, row.model) == ("deployment", "nominal")]
    return [replace(row, model="identified", value=None) for row in nominal]


def response_metrics(sailed: SimulatedMission, model: str) -> list[Metric]:
    """Compute error, step response and effort of every axis, energy, failures and time per step."""
    voyage, design, period_s = sailed.voyage, sailed.design, sailed.period_s
    log, dofs = voyage.log, voyage.dofs
    error = _in_degrees(log.eta_d - log.eta, dofs)
    values = {
        "error_mae": measure.mean_absolute(error),
        "error_mse": measure.mean_square(error),
        "iae": measure.integral_absolute_error(error, period_s),
        "itae": measure.integral_time_absolute_error(error, log.setpoint, period_s),
    }
    if stretches := measure.stands(log.setpoint, round(STAND_S / period_s)):
        off = _in_degrees(log.setpoint - log.eta, dofs)
        values["steady_state_error"] = measure.steady_state_error(
            off, stretches, period_s, design.ahead
        )
        steps = measure.step_responses(log.setpoint, log.eta, stretches, period_s, design.ahead)
        if any(np.any(~np.isnan(by_dof)) for by_dof in steps.values()):
            values |= steps
    if voyage.by_force:
        values["tau_max_abs"] = np.max(np.abs(log.tau), axis=0)
        values["tau_rms"] = measure.root_mean_square(log.tau)
        values["tau_tv"] = measure.total_variation(log.tau)
    if design.limits is not None:
        values["limit_hits"] = measure.hits(log.tau, np.array(design.limits))
    rows = [
        row
        for name, by_dof in values.items()
        for row in per_dof(name, "deployment", model, dofs, by_dof)
    ]
    totals = [
        ("energy", dof, measure.energy(power, period_s)) for dof, power in _powers(voyage).items()
    ]
    totals.append(("failures", "all", sailed.failures))
    totals.append(("held_commands", "all", np.sum(np.any(log.held != 0.0, axis=1))))
    if len(voyage.step_times):
        single = len(voyage.step_times) == len(voyage.t)  # else blocks of instants
        microseconds = 1e6 * voyage.step_times[:: design.every if single else 1]
        totals.append(("step_time_median", "all", np.median(microseconds)))
        totals.append(("step_time_p99", "all", np.percentile(microseconds, 99)))
    return rows + [metric(name, "deployment", model, dof, value) for name, dof, value in totals]


def _in_degrees(error: Array, dofs: Sequence[str]) -> Array:
    """Return the pose error with angles in degrees and the heading wrapped; shape (N, n_dof)."""
    scale = [1.0 if POSE_UNIT[dof] == "m" else 180.0 / np.pi for dof in dofs]
    wrapped = np.array(error)
    if "yaw" in dofs:
        yaw = dofs.index("yaw")
        wrapped[:, yaw] = wrap(wrapped[:, yaw])
    return np.asarray(wrapped * np.array(scale))


def _powers(voyage: Voyage) -> dict[str, Array]:
    """Return the power [W] in the plane, and about the down axis; none without forces."""
    if not voyage.by_force:
        return {}
    powers = {"position": measure.position_power(voyage.log.tau, voyage.log.nu)}
    if voyage.dofs == PLANAR:
        powers["heading"] = measure.heading_power(voyage.log.tau, voyage.log.nu)
    return powers


def warning_rows(texts: Sequence[str]) -> list[Diagnostic]:
    """Return warnings as diagnostics, to be stored with the run."""
    return [Diagnostic("warning", "all", None, label=text) for text in texts]


def losses(sailed: SimulatedMission, model: str) -> list[str]:
    """Return the problems of the simulation: forces that the thrusters could not produce."""
    shares = [row.value for row in unreached(sailed.voyage, "deployment", model)]
    return [f"{model} model: {UNREACHED.format(share)}" for share in shares if share]


UNREACHED = "unreached_share: the thrusters cannot produce {:.1%} of the commanded forces"


def is_allocated(voyage: Voyage) -> bool:
    """Return whether the commands were changed to forces that the thrusters can give.

    Then at least rounding differs.
    """
    return not voyage.positioned and not np.array_equal(voyage.log.applied, voyage.log.tau)


def unreached(voyage: Voyage, stage: Stage, model: str) -> list[Metric]:
    """Compute the share of the commands that the thrusters could not produce.

    Those of devices are shares at rest. Empty if there is no thruster allocation.
    """
    log = voyage.log
    if voyage.allocation is not None:
        able = voyage.allocation.forces().allocate(log.tau, voyage.dofs).reached
    elif is_allocated(voyage):
        able = reached(log.tau, log.applied)
    else:
        return []
    share = float(np.mean(~able))
    return [metric("unreached_share", stage, model, "all", share)]


def tracking_metrics(voyage: Voyage, model: str, period_s: float) -> list[Metric]:
    """Compute tracking error, force and power of a mission, from the true pose.

    Angles are in degrees in `e_psi`; `period_s` is the sample time [s]. The commands of a vessel
    with inputs are no forces, and its reference is a pose alone: it has the errors of the pose.
    """
    stage: Stage = "deployment"
    log = voyage.log
    rows: list[Metric] = []
    if voyage.by_force:
        for name, values in (
            ("nu_mse", measure.mean_square(log.nu_d - log.nu)),
            ("nu_dot_mse", measure.mean_square(log.nu_dot_d - log.nu_dot)),
            ("tau_mean_abs", measure.mean_absolute(log.tau)),
            ("tau_fb_mean_abs", measure.mean_absolute(log.tau_fb)),
        ):
            rows += per_dof(name, stage, model, voyage.dofs, values)
        rows += unreached(voyage, stage, model)
    errors = [("e_pos", "position", measure.position_error(log.eta_d, log.eta))]
    if voyage.dofs == PLANAR:
        errors.append(("e_psi", "heading", measure.heading_error(log.eta_d, log.eta)))
    powers = _powers(voyage)
    for name, dof, error in errors:
        shown = np.degrees(error) if dof == "heading" else error
        rows.append(metric(f"{name}_mae", stage, model, dof, np.mean(np.abs(shown))))
        rows.append(metric(f"{name}_mse", stage, model, dof, np.mean(shown**2)))
        if dof in powers:
            rows.append(metric("power_mean", stage, model, dof, np.mean(powers[dof])))
            iaew = measure.iaew(error, powers[dof], period_s)
            rows.append(metric("iaew", stage, model, dof, iaew))
    return rows
