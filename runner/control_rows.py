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
class Sailed:
    """A voyage, and what the controller that sailed it says of itself."""

    voyage: Voyage
    period_s: float
    limits: tuple[float, ...] | None  # [N, Nm]
    ahead: int  # loop instants of its preview
    failures: int  # commands that it could not compute, and held
    remarks: Sequence[Any]  # models.control.design.Remark
    needed: Array  # (n_dof,) largest force that standing still takes [N, Nm]
    adapter: Adapter | None = None  # what identified while sailing
    wind: Array | None = None  # (N, n_dof) force of the wind [N, Nm]
    every: int = 1  # loop instants from one command to the next

    @property
    def infeasible(self) -> Array:
        """Whether an axis of the limits is below the largest disturbance, shape (n_dof,)."""
        if self.limits is None:
            return np.zeros(len(self.needed), dtype=bool)
        return np.asarray(self.needed > np.array(self.limits))


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
    add("tau_rms", response.root_mean_square(log.tau), force)
    add("tau_tv", response.total_variation(log.tau), force)
    if sailed.limits is not None:
        counts = response.hits(log.tau, np.array(sailed.limits))
        add("limit_hits", counts, [""] * len(dofs))
        add("infeasible_limits", 1.0 * sailed.infeasible, [""] * len(dofs))
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
    log = sailed.voyage.log
    where = response.stands(log.setpoint, round(STAND_S / sailed.period_s))
    if not where:
        return
    error = _wrapped(log.setpoint - log.eta, sailed.voyage.dofs) * scale
    steady = response.steady_state_error(error, where, sailed.period_s, sailed.ahead)
    add("steady_state_error", steady, pose)
    steps = response.step_responses(log.setpoint, log.eta, where, sailed.period_s, sailed.ahead)
    units = {"overshoot": "%", "rise_time": "s", "settling_time": "s", "early_share": "%"}
    if any(np.any(~np.isnan(values)) for values in steps.values()):
        for name, values in steps.items():
            add(name, values, [units[name]] * len(values))


def _whole(sailed: Sailed, model: str) -> list[Metric]:
    """Energy, failures, time a step, and the spectral radius: of the whole vessel."""
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
        microseconds = 1e6 * voyage.step_times[:: sailed.every if single else 1]
        values.append(("all", "step_time_median", float(np.median(microseconds)), "us"))
        values.append(("all", "step_time_p99", float(np.percentile(microseconds, 99)), "us"))
    values += [
        (remark.dof, remark.name, remark.value, remark.unit)
        for remark in sailed.remarks
        if remark.name == "spectral_radius"
    ]
    return [Metric("deployment", model, *value) for value in values]


def diagnostics(sailed: Sailed, model: str) -> list[Diagnostic]:
    """What the controller says of its design on a model, and the force that the weather takes."""
    found = [
        Diagnostic(remark.name, remark.dof, None, None, model, remark.value, remark.unit)
        for remark in sailed.remarks
    ]
    for dof, force in zip(sailed.voyage.dofs, sailed.needed, strict=True):
        found.append(
            Diagnostic("needed_force", dof, None, None, model, float(force), FORCE_UNIT[dof])
        )
    return found


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


def warnings(sailed: Sailed, model: str) -> list[str]:
    """What the design itself shows to be wrong, one line each."""
    found = [
        f"{model} model: the closed loop's spectral radius is {remark.value:.4f}, "
        f"expected less than 1: the design does not settle on its own model"
        for remark in sailed.remarks
        if remark.name == "spectral_radius" and remark.value >= 1.0
    ]
    lost = [one.value for one in rows.unreached(sailed.voyage, "deployment", model)]
    found += [f"{model} model: {rows.UNREACHED.format(share)}" for share in lost if share]
    for i in np.flatnonzero(sailed.infeasible):
        assert sailed.limits is not None
        dof, unit = sailed.voyage.dofs[i], FORCE_UNIT[sailed.voyage.dofs[i]]
        found.append(
            f"infeasible_limits: {dof} needs up to {sailed.needed[i]:.3g} {unit} to stand still, "
            f"the limit is {sailed.limits[i]:.3g} {unit}"
        )
    return found
