"""Metrics of a deployment: tracking, response, effort, and what the design warns of."""

from collections.abc import Sequence

import numpy as np

from seatrial.models.findings import Finding
from seatrial.models.notation import FORCE_UNIT, PLANAR, POSE_UNIT
from seatrial.models.simulation import metrics as measure
from seatrial.models.simulation import step_response
from seatrial.models.simulation.voyage import Voyage
from seatrial.models.vessel.allocation import reached
from seatrial.models.vessel.basis import Array
from seatrial.runner.closed_loop import Design, Sailed
from seatrial.runner.database.records import Metric
from seatrial.runner.record.metric_rows import metric, per_dof
from seatrial.runner.vocabulary import Stage

STAND_S = 30.0  # a set-point that stays this long [s] is one to settle at


def design_metrics(design: Design, model: str) -> list[Metric]:
    """The closed loop's spectral radius, and which limits the weather exceeds."""
    found = [
        metric("spectral_radius", "deployment", model, remark.dof, float(remark.value))
        for remark in design.remarks
        if remark.name == "spectral_radius" and remark.value is not None
    ]
    if design.limits is not None:
        flags = 1.0 * design.infeasible
        found += per_dof("infeasible_limits", "deployment", model, design.dofs, flags)
    return found


def response_metrics(sailed: Sailed, model: str) -> list[Metric]:
    """How every axis answered, what it took, and how long computing it took."""
    voyage = sailed.voyage
    log, dofs = voyage.log, voyage.dofs
    error = _shown(log.eta_d - log.eta, dofs)
    itae = step_response.integral_time_absolute_error(error, log.setpoint, sailed.period_s)
    values = {
        "error_mae": measure.mean_absolute(error),
        "error_mse": measure.mean_square(error),
        "iae": step_response.integral_absolute_error(error, sailed.period_s),
        "itae": itae,
        **_steps(sailed),
        "tau_max_abs": np.max(np.abs(log.tau), axis=0),
        "tau_rms": step_response.root_mean_square(log.tau),
        "tau_tv": step_response.total_variation(log.tau),
    }
    if sailed.design.limits is not None:
        values["limit_hits"] = step_response.hits(log.tau, np.array(sailed.design.limits))
    found = [
        one
        for name, by_dof in values.items()
        for one in per_dof(name, "deployment", model, dofs, by_dof)
    ]
    return found + _whole(sailed, model)


def _shown(error: Array, dofs: Sequence[str]) -> Array:
    """The error of the pose with angles in degrees, a heading wrapped."""
    scale = [1.0 if POSE_UNIT[dof] == "m" else 180.0 / np.pi for dof in dofs]
    return np.asarray(_wrapped(error, dofs) * np.array(scale))


def _wrapped(error: Array, dofs: Sequence[str]) -> Array:
    """The same with a heading wrapped to (-pi, pi]."""
    wrapped = np.array(error)
    if "yaw" in dofs:
        column = wrapped[:, dofs.index("yaw")]
        wrapped[:, dofs.index("yaw")] = np.pi - (np.pi - column) % (2.0 * np.pi)
    return wrapped


def _steps(sailed: Sailed) -> dict[str, Array]:
    """Steady-state error and step response, where the mission has set-points that stay."""
    log, ahead = sailed.voyage.log, sailed.design.ahead
    where = step_response.stands(log.setpoint, round(STAND_S / sailed.period_s))
    if not where:
        return {}
    error = _shown(log.setpoint - log.eta, sailed.voyage.dofs)
    found = {
        "steady_state_error": step_response.steady_state_error(error, where, sailed.period_s, ahead)
    }
    steps = step_response.step_responses(log.setpoint, log.eta, where, sailed.period_s, ahead)
    stepped = any(np.any(~np.isnan(values)) for values in steps.values())
    return found | (steps if stepped else {})


def _whole(sailed: Sailed, model: str) -> list[Metric]:
    """Energy, failures and time a step: of the whole vessel."""
    voyage = sailed.voyage
    log = voyage.log
    work = step_response.energy(measure.position_power(log.tau, log.nu), sailed.period_s)
    values = [("energy", "position", work)]
    if voyage.dofs == PLANAR:
        work = step_response.energy(measure.heading_power(log.tau, log.nu), sailed.period_s)
        values.append(("energy", "heading", work))
    values.append(("failures", "all", float(sailed.failures)))
    values.append(("held_commands", "all", float(np.sum(np.any(log.held != 0.0, axis=1)))))
    if len(voyage.step_times):
        single = len(voyage.step_times) == len(voyage.t)  # else blocks of instants
        microseconds = 1e6 * voyage.step_times[:: sailed.design.every if single else 1]
        values.append(("step_time_median", "all", float(np.median(microseconds))))
        values.append(("step_time_p99", "all", float(np.percentile(microseconds, 99))))
    return [metric(name, "deployment", model, dof, value) for name, dof, value in values]


def design_findings(design: Design, model: str) -> list[Finding]:
    """What the controller says of itself, the force that the weather takes, and warnings."""
    found = [
        Finding(remark.name, remark.dof, remark.value, remark.unit, label=model)
        for remark in design.remarks
    ]
    for dof, force in zip(design.dofs, design.needed, strict=True):
        found.append(Finding("needed_force", dof, float(force), FORCE_UNIT[dof], label=model))
    return [*found, *warning_rows(design_warnings(design, model))]


def warning_rows(texts: Sequence[str]) -> list[Finding]:
    """Warnings as they are kept with a run."""
    return [Finding("warning", "all", None, label=text) for text in texts]


def design_warnings(design: Design, model: str) -> list[str]:
    """What the design itself shows to be wrong, one line each."""
    found = [
        f"{model} model: the closed loop's spectral radius is {remark.value:.4f}, "
        f"expected less than 1: the design does not settle on its own model"
        for remark in design.remarks
        if remark.name == "spectral_radius" and (remark.value or 0.0) >= 1.0
    ]
    for i in np.flatnonzero(design.infeasible):
        assert design.limits is not None
        dof, unit = design.dofs[i], FORCE_UNIT[design.dofs[i]]
        found.append(
            f"infeasible_limits: {dof} needs up to {design.needed[i]:.3g} {unit} to stand still, "
            f"the limit is {design.limits[i]:.3g} {unit}"
        )
    return found


def losses(sailed: Sailed, model: str) -> list[str]:
    """What the voyage showed to be wrong: forces that the thrusters could not give."""
    lost = [one.value for one in unreached(sailed.voyage, "deployment", model)]
    return [f"{model} model: {UNREACHED.format(share)}" for share in lost if share]


UNREACHED = "unreached_share: the thrusters cannot give {:.1%} of the forces, and give less"


def _allocated(voyage: Voyage) -> bool:
    """Whether the commands were shared among thrusters, which leaves at least rounding."""
    return not np.array_equal(voyage.log.applied, voyage.log.tau)


def unreached(voyage: Voyage, stage: Stage, model: str) -> list[Metric]:
    """Share of the commands that the thrusters could not give, where they share the force."""
    log = voyage.log
    if not _allocated(voyage):
        return []
    share = float(np.mean(~reached(log.tau, log.applied)))
    return [metric("unreached_share", stage, model, "all", share)]


def tracking_metrics(voyage: Voyage, model: str, period_s: float) -> list[Metric]:
    """Tracking, force and energy of a sailed mission, against the true pose."""
    log, dofs = voyage.log, voyage.dofs
    stage: Stage = "deployment"
    found: list[Metric] = []
    for name, values in (
        ("nu_mse", measure.mean_square(log.nu_d - log.nu)),
        ("nu_dot_mse", measure.mean_square(log.nu_dot_d - log.nu_dot)),
        ("tau_mean_abs", measure.mean_absolute(log.tau)),
        ("tau_fb_mean_abs", measure.mean_absolute(log.tau_fb)),
    ):
        found += per_dof(name, stage, model, dofs, values)
    found += unreached(voyage, stage, model)
    error = measure.position_error(log.eta_d, log.eta)
    power = measure.position_power(log.tau, log.nu)
    iaew = measure.iaew(error, power, period_s)
    parts = [("e_pos", "position", error, power, iaew)]
    if dofs == PLANAR:
        error = measure.heading_error(log.eta_d, log.eta)
        power = measure.heading_power(log.tau, log.nu)
        iaew = measure.iaew(error, power, period_s)
        parts.append(("e_psi", "heading", np.degrees(error), power, iaew))
    for name, dof, error, power, iaew in parts:
        found += [
            metric(f"{name}_mae", stage, model, dof, float(np.mean(np.abs(error)))),
            metric(f"{name}_mse", stage, model, dof, float(np.mean(error**2))),
            metric("power_mean", stage, model, dof, float(np.mean(power))),
            metric("iaew", stage, model, dof, iaew),
        ]
    return found
