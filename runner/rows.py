"""The rows that a trial stores: metrics, coefficients, diagnostics and series, with units."""

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from models import metrics as measure
from models.allocation import reached
from models.basis import Array, Term
from models.excitation.persistence import Persistence
from models.identification.problem import Identified, lack_of_fit
from models.recording import Recording
from models.simulation import Voyage
from models.vessel import (
    FORCE_UNIT,
    PLANAR,
    Vessel,
    accelerations_of,
    coefficient_unit,
    poses_of,
    velocities_of,
)
from models.weather import Weather
from runner.database.records import Coefficient, Diagnostic, Metric, Series, Stage

if TYPE_CHECKING:
    from runner.control_rows import Sailed
    from runner.trial import Excited

Mask = NDArray[np.bool_]
UNREACHED = "unreached_share: the thrusters cannot give {:.1%} of the forces, and give less"
MATRICES = ("A", "B", "C", "D", "K", "F", "x0")  # of a state-space model
SPEED_UNIT = {"N": "m/s", "Nm": "rad/s"}
POSE_UNIT = {"N": "m", "Nm": "rad"}


def _square(unit: str) -> str:
    return f"({unit})^2" if len(unit) > 1 else f"{unit}^2"


def per_dof(
    stage: Stage, model: str, name: str, values: Array, dofs: Iterable[str], units: Iterable[str]
) -> list[Metric]:
    """One metric a degree of freedom."""
    return [
        Metric(stage, model, dof, name, float(value), unit)
        for dof, value, unit in zip(dofs, values, units, strict=True)
    ]


def validation(
    held_out: Recording, nominal: Vessel, identified: Identified, truth: Vessel | None
) -> list[Metric]:
    """One-step force residuals on the held-out part, of every model, and what they show."""
    models = {"nominal": nominal, "identified": identified.model}
    if truth is not None:
        models["plant"] = truth
    forces = {"": "commanded"}
    if held_out.tau_filtered is not None:
        forces["_filtered"] = "filtered"
    dofs = held_out.dofs
    units = [FORCE_UNIT[dof] for dof in dofs]
    found: list[Metric] = []
    flags = np.zeros(len(dofs), dtype=bool)
    for suffix, force in forces.items():
        residuals = {name: lack_of_fit(held_out, model, force) for name, model in models.items()}
        squares = {name: measure.mean_square(e) for name, e in residuals.items()}
        for name, e in residuals.items():
            square = [_square(unit) for unit in units]
            mse = squares[name]
            found += per_dof("validation", name, f"force_mse{suffix}", mse, dofs, square)
            mae = measure.mean_absolute(e)
            found += per_dof("validation", name, f"force_mae{suffix}", mae, dofs, units)
        if truth is not None:
            variance = np.var(held_out.force(force), axis=0)
            flags |= measure.below_true_model(squares["identified"], squares["plant"], variance)
    if truth is not None:
        ones = [""] * len(dofs)
        found += per_dof("validation", "identified", "below_true_model", 1.0 * flags, dofs, ones)
        found += _coefficient_errors(nominal, "nominal", truth)
        found += _coefficient_errors(identified.model, "identified", truth)
        own = truth.on(nominal.terms)
        found += _median_error(nominal, "nominal", own) + _median_error(
            identified.model, "identified", own
        )
    return found


def _coefficient_errors(model: Vessel, name: str, truth: Vessel) -> list[Metric]:
    """Largest relative error per degree of freedom over the coefficients that are not zero."""
    errors = measure.relative_errors(model.on(truth.terms).theta, truth.theta)
    known = ~np.isnan(errors)
    worst = np.where(known, errors, 0.0).max(axis=0, initial=0.0)
    return [
        Metric("validation", name, dof, "coefficient_error", float(value), "")
        for dof, value, any_known in zip(
            truth.dofs, worst, np.atleast_1d(known.any(axis=0)), strict=True
        )
        if any_known
    ]


def _median_error(model: Vessel, name: str, truth: Vessel) -> list[Metric]:
    """Median relative error over the true coefficients of the vessel's own terms, wind's apart."""
    errors = measure.relative_errors(model.on(truth.terms).theta, truth.theta)
    known = errors[~np.isnan(errors)]
    middle = float(np.median(known)) if known.size else float("nan")
    return [Metric("validation", name, "all", "coefficient_error_median", middle, "")]


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


def deployment(voyage: Voyage, model: str, period_s: float) -> list[Metric]:
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


def coefficients(
    nominal: Vessel, identified: Identified, truth: Vessel | None
) -> list[Coefficient]:
    """Every coefficient that is not zero, with its standard error and true value where known."""
    truths = {
        "nominal": truth,
        "residual": None if truth is None else truth - nominal,
        "identified": truth,
        "plant": None,
    }
    tables = {"nominal": nominal, "residual": identified.residual, "identified": identified.model}
    if truth is not None:
        tables["plant"] = truth
    errors = _standard_errors(identified)
    found = []
    for model, table in tables.items():
        true = truths[model]
        union = table if true is None or model == "nominal" else (0.0 * true) + table
        for one, row in zip(union.terms, union.theta, strict=True):
            for dof, value in zip(union.dofs, row, strict=True):
                error = errors.get((one, dof)) if model in ("residual", "identified") else None
                truth_here = None if true is None else true.coefficient(dof, one.name)
                if value or error is not None or truth_here:
                    unit = coefficient_unit(one, dof)
                    found.append(
                        Coefficient(model, dof, one.name, float(value), error, truth_here, unit)
                    )
    return found


def _standard_errors(identified: Identified) -> dict[tuple[Term, str], float]:
    """Standard error of each estimated coefficient, by term and degree of freedom."""
    if identified.std_error is None:
        return {}
    residual = identified.residual
    return {
        (one, dof): float(identified.std_error[i, j])
        for i, one in enumerate(residual.terms)
        for j, dof in enumerate(residual.dofs)
        if np.isfinite(identified.std_error[i, j])
    }


def diagnostics(identified: Identified) -> list[Diagnostic]:
    """The identifier's findings, but for the matrix entries, which are coefficients."""
    return [
        Diagnostic(f.name, f.dof, f.i, f.j, f.label, f.value, f.unit)
        for f in identified.findings
        if f.name not in MATRICES
    ]


def state_space_coefficients(identified: Identified) -> list[Coefficient]:
    """Every matrix entry of a state-space model, as model `state_space`, term `A[1,2]`."""
    found = []
    for f in identified.findings:
        if f.name in MATRICES:
            place = f"[{f.i},{f.j}]" if f.j else f"[{f.i}]"
            term = f"{f.name}{place}"
            found.append(Coefficient("state_space", f.dof, term, f.value, None, None, f.unit))
    return found


def stage_coefficients(identified: Identified) -> list[Coefficient]:
    """The residual table of each stage, as models `stage_1` and so on; zeros left out."""
    return [
        Coefficient(
            f"stage_{i}", dof, one.name, float(value), None, None, coefficient_unit(one, dof)
        )
        for i, table in enumerate(identified.stages, start=1)
        for one, row in zip(table.terms, table.theta, strict=True)
        for dof, value in zip(table.dofs, row, strict=True)
        if value
    ]


def excitation_report(reports: Iterable[Persistence]) -> list[Diagnostic]:
    """What the training data can tell apart of the nominal model's terms."""
    found = []
    for one in reports:
        numbers = {
            "regressor_condition": one.condition,
            "regressor_rank": float(one.rank),
            "regressor_unknowns": float(one.unknowns),
            "spectral_lines": float(one.lines),
        }
        found += [
            Diagnostic(name, one.dof, None, None, None, number, "")
            for name, number in numbers.items()
            if np.isfinite(number)
        ]
        groups = [(name,) for name in one.unexcited] + list(one.inseparable)
        found += [
            Diagnostic("inseparable_terms", one.dof, i, None, " ".join(group), 1.0 * len(group), "")
            for i, group in enumerate(groups)
        ]
    return found


def _columns(names: Iterable[str], values: Array) -> dict[str, Array]:
    return dict(zip(names, np.asarray(values).T, strict=True))


def _units(dofs: tuple[str, ...], columns: Iterable[str]) -> dict[str, str]:
    """Units of series columns by their names."""
    force = {dof: FORCE_UNIT[dof] for dof in dofs}
    units = {"t": "s", "train": "", "e_pos": "m", "e_psi": "rad"}
    units |= {f"{what}_{way}": "m/s" for what in ("wind", "current") for way in ("north", "east")}
    units |= {"noise_wind_ahead": "m/s", "noise_wind_abeam": "m/s"}
    units |= {name: POSE_UNIT[force[dof]] for name, dof in zip(poses_of(dofs), dofs, strict=True)}
    for dof, speed, acceleration in zip(
        dofs, velocities_of(dofs), accelerations_of(dofs), strict=True
    ):
        units[speed] = SPEED_UNIT[force[dof]]
        units[acceleration] = f"{SPEED_UNIT[force[dof]]}^2"

    def unit(column: str) -> str:
        return (
            units.get(column)
            or units.get(column.removesuffix("_d"))
            or units.get(column.removeprefix("wave_"))
            or units.get(column.removeprefix("noise_"))
            or units.get(column.removeprefix("process_"))
            or force.get(column.rpartition("_")[2], "")
        )

    return {column: unit(column) for column in columns}


def _weather(weather: Weather, dofs: tuple[str, ...]) -> dict[str, Array]:
    """The realised disturbances that vary, as far as they are present."""
    ways = ("north", "east")
    parts = (
        ([f"wind_{way}" for way in ways], weather.wind_ned),
        ([f"current_{way}" for way in ways], weather.current_ned),
        ([f"wave_{name}" for name in poses_of(dofs)], weather.wave_motion),
        ([f"process_{name}" for name in accelerations_of(dofs)], weather.process),
    )
    return {k: v for names, part in parts if len(part) for k, v in _columns(names, part).items()}


def _noise(weather: Weather, dofs: tuple[str, ...]) -> dict[str, Array]:
    """The realised measurement noise and the force in NED, where there is some."""
    waves = weather.wave_motion if len(weather.wave_motion) else 0.0
    parts = (
        ([f"noise_{name}" for name in poses_of(dofs)], weather.pose_noise - waves),
        ([f"noise_{name}" for name in velocities_of(dofs)], weather.velocity_noise),
        ([f"noise_{name}" for name in accelerations_of(dofs)], weather.acceleration_noise),
        (["noise_wind_ahead", "noise_wind_abeam"], weather.wind_noise),
        ([f"force_ned_{dof}" for dof in dofs], weather.force_ned),
    )
    return {k: v for names, part in parts if np.any(part) for k, v in _columns(names, part).items()}


def recording_series(recording: Recording, training: Mask, sailed: "Sailed | None") -> Series:
    """The whole recording, as measured, and of a simulation the weather that was sailed in."""
    dofs = recording.dofs
    columns = {"t": recording.t, "train": training.astype(np.float64)}
    columns |= _columns(poses_of(dofs), recording.eta)
    columns |= _columns(velocities_of(dofs), recording.nu)
    columns |= _columns(accelerations_of(dofs), recording.nu_dot)
    columns |= _columns([f"tau_{dof}" for dof in dofs], recording.tau)
    if recording.tau_actual is not None:
        columns |= _columns([f"tau_actual_{dof}" for dof in dofs], recording.tau_actual)
    if sailed is not None:
        columns |= _weather(sailed.voyage.weather, dofs)
        columns |= _noise(sailed.voyage.weather, dofs)
        columns |= asked(sailed.voyage)
        if sailed.wind is not None:
            columns |= _columns([f"wind_{dof}" for dof in dofs], sailed.wind)
    return Series("recording", columns, _units(dofs, columns))


def asked(voyage: Voyage) -> dict[str, Array]:
    """The commands before the thrusters' allocation, where it changes them."""
    if not _allocated(voyage):
        return {}
    return _columns([f"tau_asked_{dof}" for dof in voyage.dofs], voyage.log.tau)


def residual_series(excited: "Excited", nominal: Vessel, identified: Identified) -> Series:
    """Commanded force and its residual from every model over the whole recording."""
    recording = excited.recording
    dofs = recording.dofs
    columns = {"t": recording.t, "train": excited.training.astype(np.float64)}
    columns |= _columns([f"tau_{dof}" for dof in dofs], recording.tau)
    models = {"nominal": nominal, "identified": identified.model}
    if excited.truth is not None:
        models["plant"] = excited.truth
    for name, model in models.items():
        residual = lack_of_fit(recording, model, "commanded")
        columns |= _columns([f"residual_{name}_{dof}" for dof in dofs], residual)
    return Series("residual", columns, _units(dofs, columns))


def deployment_series(voyage: Voyage, model: str) -> Series:
    """A sailed mission: true pose, reference, velocities, forces, errors and weather over time."""
    log, dofs = voyage.log, voyage.dofs
    columns = {"t": voyage.t}
    columns |= _columns(poses_of(dofs), log.eta)
    columns |= _columns([f"{name}_d" for name in poses_of(dofs)], log.eta_d)
    columns |= _columns(velocities_of(dofs), log.nu)
    columns |= _columns([f"{name}_d" for name in velocities_of(dofs)], log.nu_d)
    columns |= _columns([f"tau_{dof}" for dof in dofs], log.tau)
    columns |= _columns([f"tau_fb_{dof}" for dof in dofs], log.tau_fb)
    if _allocated(voyage):
        columns |= _columns([f"tau_applied_{dof}" for dof in dofs], log.applied)
    columns["e_pos"] = measure.position_error(log.eta_d, log.eta)
    if dofs == PLANAR:
        columns["e_psi"] = measure.heading_error(log.eta_d, log.eta)
    columns |= _weather(voyage.weather, dofs)
    return Series(f"deployment_{model}", columns, _units(dofs, columns))
