"""Metrics of a deployment: tracking, response, effort, and what the design warns of."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from seatrial.models.findings import Finding
from seatrial.models.simulation import metrics as measure
from seatrial.models.simulation import step_response
from seatrial.models.simulation.voyage import Voyage
from seatrial.models.vessel.allocation import reached
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import (
    FORCE_UNIT,
    PLANAR,
)
from seatrial.runner.closed_loop import Design, Sailed
from seatrial.runner.database.records import Metric, Stage
from seatrial.runner.record.validation_metrics import SPEED_UNIT, _square, per_dof

if TYPE_CHECKING:
    from seatrial.runner.closed_loop import Sailed


STAND_S = 30.0  # a set-point that stays this long [s] is one to settle at


def design_metrics(design: Design, model: str) -> list[Metric]:
    """The closed loop's spectral radius, and which limits the weather exceeds."""
    found = [
        Metric("deployment", model, remark.dof, remark.name, remark.value, remark.unit)
        for remark in design.remarks
        if remark.name == "spectral_radius"
    ]
    if design.limits is not None:
        found += [
            Metric("deployment", model, dof, "infeasible_limits", float(flag), "")
            for dof, flag in zip(design.dofs, design.infeasible, strict=True)
        ]
    return found


def response_metrics(sailed: Sailed, model: str) -> list[Metric]:
    """How every axis answered, what it took, and how long computing it took."""
    voyage = sailed.voyage
    log, dofs = voyage.log, voyage.dofs
    scale = np.array([1.0 if FORCE_UNIT[dof] == "N" else 180.0 / np.pi for dof in dofs])
    pose = ["m" if FORCE_UNIT[dof] == "N" else "deg" for dof in dofs]
    force = [FORCE_UNIT[dof] for dof in dofs]
    found: list[Metric] = []

    def add(name: str, values: Array, units: Sequence[str]) -> None:
        found.extend(
            Metric("deployment", model, dof, name, float(value), unit)
            for dof, value, unit in zip(dofs, values, units, strict=True)
        )

    error = _wrapped(log.eta_d - log.eta, dofs) * scale
    add("error_mae", measure.mean_absolute(error), pose)
    add("error_mse", measure.mean_square(error), [f"{unit}^2" for unit in pose])
    add(
        "iae",
        step_response.integral_absolute_error(error, sailed.period_s),
        [f"{u} s" for u in pose],
    )
    itae = step_response.integral_time_absolute_error(error, log.setpoint, sailed.period_s)
    add("itae", itae, [f"{unit} s^2" for unit in pose])
    _steps(sailed, scale, pose, add)
    add("tau_max_abs", np.max(np.abs(log.tau), axis=0), force)
    add("tau_rms", step_response.root_mean_square(log.tau), force)
    add("tau_tv", step_response.total_variation(log.tau), force)
    if sailed.design.limits is not None:
        counts = step_response.hits(log.tau, np.array(sailed.design.limits))
        add("limit_hits", counts, [""] * len(dofs))
    return found + _whole(sailed, model)


def _wrapped(error: Array, dofs: Sequence[str]) -> Array:
    """The same with a heading wrapped to (-pi, pi]."""
    wrapped = np.array(error)
    if "yaw" in dofs:
        column = wrapped[:, dofs.index("yaw")]
        wrapped[:, dofs.index("yaw")] = np.pi - (np.pi - column) % (2.0 * np.pi)
    return wrapped


def _steps(
    sailed: Sailed, scale: Array, pose: Sequence[str],
    add: Callable[[str, Array, Sequence[str]], None],
) -> None:  # fmt: skip
    """Steady-state error and step response, where the mission has set-points that stay."""
    log, ahead = sailed.voyage.log, sailed.design.ahead
    where = step_response.stands(log.setpoint, round(STAND_S / sailed.period_s))
    if not where:
        return
    error = _wrapped(log.setpoint - log.eta, sailed.voyage.dofs) * scale
    steady = step_response.steady_state_error(error, where, sailed.period_s, ahead)
    add("steady_state_error", steady, pose)
    steps = step_response.step_responses(log.setpoint, log.eta, where, sailed.period_s, ahead)
    units = {"overshoot": "%", "rise_time": "s", "settling_time": "s", "early_share": "%"}
    if any(np.any(~np.isnan(values)) for values in steps.values()):
        for name, values in steps.items():
            add(name, values, [units[name]] * len(values))


def _whole(sailed: Sailed, model: str) -> list[Metric]:
    """Energy, failures and time a step: of the whole vessel."""
    voyage = sailed.voyage
    log = voyage.log
    work = step_response.energy(measure.position_power(log.tau, log.nu), sailed.period_s)
    values = [("position", "energy", work, "J")]
    if voyage.dofs == PLANAR:
        work = step_response.energy(measure.heading_power(log.tau, log.nu), sailed.period_s)
        values.append(("heading", "energy", work, "J"))
    values.append(("all", "failures", float(sailed.failures), ""))
    values.append(("all", "held_commands", float(np.sum(np.any(log.held != 0.0, axis=1))), ""))
    if len(voyage.step_times):
        single = len(voyage.step_times) == len(voyage.t)  # else blocks of instants
        microseconds = 1e6 * voyage.step_times[:: sailed.design.every if single else 1]
        values.append(("all", "step_time_median", float(np.median(microseconds)), "us"))
        values.append(("all", "step_time_p99", float(np.percentile(microseconds, 99)), "us"))
    return [Metric("deployment", model, *value) for value in values]


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
    return [Metric(stage, model, "all", "unreached_share", share, "")]


def tracking_metrics(voyage: Voyage, model: str, period_s: float) -> list[Metric]:
    """Tracking, force and energy of a sailed mission, against the true pose."""
    log, dofs = voyage.log, voyage.dofs
    force_units = [FORCE_UNIT[dof] for dof in dofs]
    speeds = [SPEED_UNIT[unit] for unit in force_units]
    stage: Stage = "deployment"
    rates = measure.mean_square(log.nu_d - log.nu)
    accelerations = measure.mean_square(log.nu_dot_d - log.nu_dot)
    squares = [_square(unit) for unit in speeds]
    found = per_dof(stage, model, "nu_mse", rates, dofs, squares)
    squares = [_square(f"{unit}^2") for unit in speeds]
    found += per_dof(stage, model, "nu_dot_mse", accelerations, dofs, squares)
    for name, tau in (("tau_mean_abs", log.tau), ("tau_fb_mean_abs", log.tau_fb)):
        found += per_dof(stage, model, name, measure.mean_absolute(tau), dofs, force_units)
    found += unreached(voyage, stage, model)
    error = measure.position_error(log.eta_d, log.eta)
    power = measure.position_power(log.tau, log.nu)
    found += [
        Metric(stage, model, "position", "e_pos_mae", float(np.mean(np.abs(error))), "m"),
        Metric(stage, model, "position", "e_pos_mse", float(np.mean(error**2)), "m^2"),
        Metric(stage, model, "position", "power_mean", float(np.mean(power)), "W"),
        Metric(stage, model, "position", "iaew", measure.iaew(error, power, period_s), "m J s"),
    ]
    if dofs == PLANAR:
        error = measure.heading_error(log.eta_d, log.eta)
        degrees = np.degrees(error)
        power = measure.heading_power(log.tau, log.nu)
        found += [
            Metric(stage, model, "heading", "e_psi_mae", float(np.mean(np.abs(degrees))), "deg"),
            Metric(stage, model, "heading", "e_psi_mse", float(np.mean(degrees**2)), "deg^2"),
            Metric(stage, model, "heading", "power_mean", float(np.mean(power)), "W"),
            Metric(
                stage, model, "heading", "iaew", measure.iaew(error, power, period_s), "rad J s"
            ),
        ]
    return found
