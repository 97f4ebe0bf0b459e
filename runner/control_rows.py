"""The rows that a deployment stores of its controller: response, effort, design and warnings."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from models import metrics as measure
from models import response
from models.basis import Array
from models.simulation import Voyage
from models.vessel import FORCE_UNIT, PLANAR, poses_of
from runner import rows
from runner.adaptive import Adapter
from runner.database.records import Diagnostic, Metric, Series

STAND_S = 30.0  # a set-point that stays this long [s] is one to settle at


@dataclass(frozen=True, eq=False)
class Design:
    """What a controller says of itself on a model, known before it sails."""

    dofs: tuple[str, ...]
    needed: Array  # (n_dof,) largest force that standing still takes [N, Nm]
    limits: tuple[float, ...] | None = None  # [N, Nm]
    ahead: int = 0  # loop instants of its preview
    every: int = 1  # loop instants from one command to the next
    remarks: Sequence[Any] = ()  # models.control.design.Remark

    @property
    def infeasible(self) -> Array:
        """Whether an axis of the limits is below the largest disturbance, shape (n_dof,)."""
        if self.limits is None:
            return np.zeros(len(self.needed), dtype=bool)
        return np.asarray(self.needed > np.array(self.limits))


@dataclass(frozen=True, eq=False)
class Sailed:
    """A voyage, and the design that sailed it."""

    voyage: Voyage
    period_s: float
    design: Design
    failures: int = 0  # commands that the controller could not compute, and held
    adapter: Adapter | None = None  # what identified while sailing
    wind: Array | None = None  # (N, n_dof) force of the wind [N, Nm]


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


def metrics(sailed: Sailed, model: str) -> list[Metric]:
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
    add("iae", response.integral_absolute_error(error, sailed.period_s), [f"{u} s" for u in pose])
    itae = response.integral_time_absolute_error(error, log.setpoint, sailed.period_s)
    add("itae", itae, [f"{unit} s^2" for unit in pose])
    _steps(sailed, scale, pose, add)
    add("tau_max_abs", np.max(np.abs(log.tau), axis=0), force)
    add("tau_rms", response.root_mean_square(log.tau), force)
    add("tau_tv", response.total_variation(log.tau), force)
    if sailed.design.limits is not None:
        counts = response.hits(log.tau, np.array(sailed.design.limits))
        add("limit_hits", counts, [""] * len(dofs))
    return found + _whole(sailed, model)


def _wrapped(error: Array, dofs: Sequence[str]) -> Array:
    """The same with a heading wrapped to (-pi, pi]."""
    wrapped = np.array(error)
    if "yaw" in dofs:
        column = wrapped[:, dofs.index("yaw")]
        wrapped[:, dofs.index("yaw")] = np.pi - (np.pi - column) % (2.0 * np.pi)
    return wrapped


def _steps(sailed: Sailed, scale: Array, pose: Sequence[str], add: Any) -> None:
    """Steady-state error and step response, where the mission has set-points that stay."""
    log, ahead = sailed.voyage.log, sailed.design.ahead
    where = response.stands(log.setpoint, round(STAND_S / sailed.period_s))
    if not where:
        return
    error = _wrapped(log.setpoint - log.eta, sailed.voyage.dofs) * scale
    steady = response.steady_state_error(error, where, sailed.period_s, ahead)
    add("steady_state_error", steady, pose)
    steps = response.step_responses(log.setpoint, log.eta, where, sailed.period_s, ahead)
    units = {"overshoot": "%", "rise_time": "s", "settling_time": "s", "early_share": "%"}
    if any(np.any(~np.isnan(values)) for values in steps.values()):
        for name, values in steps.items():
            add(name, values, [units[name]] * len(values))


def _whole(sailed: Sailed, model: str) -> list[Metric]:
    """Energy, failures and time a step: of the whole vessel."""
    voyage = sailed.voyage
    log = voyage.log
    work = response.energy(measure.position_power(log.tau, log.nu), sailed.period_s)
    values = [("position", "energy", work, "J")]
    if voyage.dofs == PLANAR:
        work = response.energy(measure.heading_power(log.tau, log.nu), sailed.period_s)
        values.append(("heading", "energy", work, "J"))
    values.append(("all", "failures", float(sailed.failures), ""))
    values.append(("all", "held_commands", float(np.sum(np.any(log.held != 0.0, axis=1))), ""))
    if len(voyage.step_times):
        single = len(voyage.step_times) == len(voyage.t)  # else blocks of instants
        microseconds = 1e6 * voyage.step_times[:: sailed.design.every if single else 1]
        values.append(("all", "step_time_median", float(np.median(microseconds)), "us"))
        values.append(("all", "step_time_p99", float(np.percentile(microseconds, 99)), "us"))
    return [Metric("deployment", model, *value) for value in values]


def diagnostics(design: Design, model: str) -> list[Diagnostic]:
    """What the controller says of itself, the force that the weather takes, and warnings."""
    found = [
        Diagnostic(remark.name, remark.dof, None, None, model, remark.value, remark.unit)
        for remark in design.remarks
    ]
    for dof, force in zip(design.dofs, design.needed, strict=True):
        found.append(
            Diagnostic("needed_force", dof, None, None, model, float(force), FORCE_UNIT[dof])
        )
    return [*found, *warning_rows(warnings(design, model))]


def warning_rows(texts: Sequence[str]) -> list[Diagnostic]:
    """Warnings as they are kept with a run."""
    return [Diagnostic("warning", "all", None, None, text, None, "") for text in texts]


def series(sailed: Sailed, model: str) -> Series:
    """The deployment over time, with set-points and the force of the wind where there are some."""
    one = rows.deployment_series(sailed.voyage, model)
    dofs, log = sailed.voyage.dofs, sailed.voyage.log
    columns, units = dict(one.columns), dict(one.units)
    for i, (name, dof) in enumerate(zip(poses_of(dofs), dofs, strict=True)):
        columns[f"{name}_setpoint"] = log.setpoint[:, i]
        units[f"{name}_setpoint"] = units[name]
        if sailed.wind is not None:
            columns[f"wind_{dof}"] = sailed.wind[:, i]
            units[f"wind_{dof}"] = FORCE_UNIT[dof]
    return replace(one, columns=columns, units=units)


def warnings(design: Design, model: str) -> list[str]:
    """What the design itself shows to be wrong, one line each."""
    found = [
        f"{model} model: the closed loop's spectral radius is {remark.value:.4f}, "
        f"expected less than 1: the design does not settle on its own model"
        for remark in design.remarks
        if remark.name == "spectral_radius" and remark.value >= 1.0
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
    lost = [one.value for one in rows.unreached(sailed.voyage, "deployment", model)]
    return [f"{model} model: {rows.UNREACHED.format(share)}" for share in lost if share]
