"""The catalogue of metrics: every metric that a trial stores is declared here once.

A declaration gives the name of a metric, its unit for each degree of freedom, which values are
better, and its definition in words. Stored rows, the database's views, tables, figures, reports and
the command `seatrial-results metrics` read it. A user-defined metric is declared with `register` in
its own module. An undeclared metric in a database is shown with its stored unit, and no value
is marked as better.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

from seatrial.models.notation import (
    ACCELERATION_UNIT,
    FORCE_UNIT,
    MEASURES,
    POSE_UNIT,
    SQUARE_UNIT,
    VELOCITY_UNIT,
)
from seatrial.runner.record.vocabulary import Stage

Unit = str | Mapping[str, str]
Better = Literal["lower", "higher"] | float | None


@dataclass(frozen=True)
class Definition:
    """The definition of a metric.

    `stages` are the stages of a trial that store it. `unit` is one unit, or a unit per degree of
    freedom. `better` is `lower`, `higher`, a target value, or None if no value is better. `label`
    names the metric on axes, `formula` defines it in words, `caption` is the heading of its table
    in a report (by default the label), and `note` is printed under every table that shows it. A
    `wide` metric is a column of the view `metric_wide`; a metric with a `headline` is a column of
    `run_overview`, for that degree of freedom. A `score` has no
    natural zero: it is compared by differences, not by ratios. Values that differ by less than the
    `resolution`, in their unit, are equal in a comparison.
    """

    name: str
    stages: tuple[Stage, ...]
    unit: Unit
    better: Better
    label: str
    formula: str
    caption: str = ""
    note: str = ""
    wide: bool = False
    headline: str = ""
    score: bool = False
    resolution: float = 1e-6

    @property
    def heading(self) -> str:
        """The caption, or by default the label."""
        return self.caption or self.label

    def unit_of(self, dof: str) -> str:
        """Return the unit for a degree of freedom; raises KeyError if there is none."""
        if isinstance(self.unit, str):
            return self.unit
        if dof not in self.unit:
            expected = ", ".join(self.unit)
            raise KeyError(f"metric {self.name}: got dof {dof!r}, expected one of {expected}")
        return self.unit[dof]

    @property
    def units(self) -> str:
        """All units of the metric as text: `N^2, (Nm)^2`."""
        units = [self.unit] if isinstance(self.unit, str) else self.unit.values()
        return ", ".join(dict.fromkeys(units))

    @property
    def better_text(self) -> str:
        """Which values are better, as text; empty if none are."""
        if isinstance(self.better, int | float):
            return f"nearer to {self.better:g}"
        return self.better or ""


def _each(units: Mapping[str, str], form: str) -> dict[str, str]:
    """Derive units from other units: `_each(POSE_UNIT, "{} s")` is m s and rad s."""
    return {dof: form.format(unit) for dof, unit in units.items()}


VALIDATION: tuple[Stage, ...] = ("validation",)
DEPLOYMENT: tuple[Stage, ...] = ("deployment",)
IDENTIFICATION: tuple[Stage, ...] = ("identification",)
POSE_IN_DEGREES = {dof: "m" if unit == "m" else "deg" for dof, unit in POSE_UNIT.items()}
VELOCITY_SQUARED = _each(VELOCITY_UNIT, "({})^2")
ACCELERATION_SQUARED = _each(ACCELERATION_UNIT, "({})^2")
ENERGY = {"position": "J", "heading": "J"}
POWER = {"position": "W", "heading": "W"}
HIDES_BIAS = (
    "one step ahead hides bias, for the measured state corrects a model at every sample: judge by"
    " free_run"
)

# Horizons of the predictions: their words in labels and in formulas.
HORIZONS = {
    "one_step": ("one step (hides bias)", "one step after every measured state"),
    "ten_step": ("ten steps", "ten steps after every measured state"),
    "restarts": ("30 s", "in predictions of 30 s, each from a measured state"),
    "free_run": ("free run", "in a free run over the held-out part"),
}
QUANTITIES: dict[str, Mapping[str, str]] = {"pose": POSE_UNIT, "velocity": VELOCITY_UNIT}
PER_FILE = (  # also stored for each of several files that are tested on
    "force_mse",
    *(
        f"{quantity}_{kind}_{horizon}"
        for quantity in QUANTITIES
        for kind in ("rmse", "r2")
        for horizon in ("restarts", "free_run")
    ),
)
SCORES = {
    "fit": ("FIT", "%", "100 (1 - RMSE / standard deviation of the measured signal)"),
    "r2": ("R^2", "", "1 - mean square error / variance of the measured signal"),
    "vaf": ("VAF", "%", "100 (1 - variance of the error / variance of the measured signal)"),
}
OVER_AXES = "; of all axes the mean over those that moved"


def _predictions() -> Iterator[Definition]:
    """The errors, the scores and the divergence of predictions over each horizon."""
    for horizon, (short, words) in HORIZONS.items():
        note = HIDES_BIAS if horizon == "one_step" else ""
        for quantity, units in QUANTITIES.items():
            title = quantity.capitalize()
            headed = quantity == "velocity" and horizon == "free_run"
            yield Definition(
                f"{quantity}_rmse_{horizon}", VALIDATION, units, "lower",
                f"{title} RMSE, {short}", f"root mean square error of the {quantity} {words}",
                "Velocity error of a free run over the held-out part" if headed else "",
                note=note, wide=True,
            )  # fmt: skip
            for score, (label, unit, formula) in SCORES.items():
                yield Definition(
                    f"{quantity}_{score}_{horizon}", VALIDATION, unit, "higher",
                    f"{title} {label}, {short}", f"{formula}, of the {quantity} {words}{OVER_AXES}",
                    note=note, score=True,
                )  # fmt: skip
        yield Definition(
            f"limited_share_{horizon}", VALIDATION, "", "lower", f"Limited rates, {short}",
            f"share of the rates of change that had to be limited {words}; above 0 the model"
            " diverges and its errors over this horizon have no value",
        )  # fmt: skip
    yield Definition(
        "held_free_run", VALIDATION, "s", "higher", "Time the free run held",
        "time until a rate of change had to be limited, or the length of the free run",
    )  # fmt: skip


PREDICTIONS = tuple(_predictions())
METRICS = (
    Definition(
        "force_mse", VALIDATION, SQUARE_UNIT, "lower", "Force MSE",
        "mean square of the commanded force less the model's, on the held-out part",
        "Force residual on the held-out part", wide=True, headline="surge",
        resolution=1e-12,
    ),
    Definition(
        "force_mae", VALIDATION, FORCE_UNIT, "lower", "Force MAE",
        "mean absolute commanded force less the model's, on the held-out part", wide=True,
    ),
    Definition(
        "force_mse_filtered", VALIDATION, SQUARE_UNIT, "lower", "Force MSE, filtered",
        "as force_mse, of the commanded force after the known thruster lag",
        "Force residual, thruster lag taken into account", wide=True, resolution=1e-12,
    ),
    Definition(
        "force_mae_filtered", VALIDATION, FORCE_UNIT, "lower", "Force MAE, filtered",
        "as force_mae, of the commanded force after the known thruster lag",
    ),
    Definition(
        "below_true_model", VALIDATION, "", None, "Below the true model",
        "1 where the force MSE is below 0.99 times the true plant's: the model then fits lag or"
        " feedback, not the vessel", wide=True,
    ),
    Definition(
        "coefficient_error", VALIDATION, "", "lower", "Relative coefficient error",
        "largest |estimate - true| / |true| over the coefficients whose true value is not zero",
        "Largest relative error of a coefficient", wide=True,
    ),
    Definition(
        "coefficient_error_median", VALIDATION, "", "lower", "Relative coefficient error, median",
        "median of |estimate - true| / |true| over the coefficients of the vessel's own terms",
    ),
    *PREDICTIONS,
    Definition(
        "e_pos_mae", DEPLOYMENT, {"position": "m"}, "lower", "Position MAE",
        "mean distance from the reference position", "Position error when deployed",
        wide=True, headline="position",
    ),
    Definition(
        "e_pos_mse", DEPLOYMENT, {"position": "m^2"}, "lower", "Position MSE",
        "mean square distance from the reference position", wide=True, resolution=1e-12,
    ),
    Definition(
        "e_psi_mae", DEPLOYMENT, {"heading": "deg"}, "lower", "Heading MAE",
        "mean absolute heading error, wrapped to (-180, 180] deg", "Heading error when deployed",
        wide=True, headline="heading",
    ),
    Definition(
        "e_psi_mse", DEPLOYMENT, {"heading": "deg^2"}, "lower", "Heading MSE",
        "mean square heading error, wrapped to (-180, 180] deg", wide=True,
        resolution=1e-12,
    ),
    Definition(
        "nu_mse", DEPLOYMENT, VELOCITY_SQUARED, "lower", "Velocity MSE",
        "mean square error of the velocity against its reference", wide=True,
        resolution=1e-12,
    ),
    Definition(
        "nu_dot_mse", DEPLOYMENT, ACCELERATION_SQUARED, "lower", "Acceleration MSE",
        "mean square error of the acceleration against its reference", wide=True,
        resolution=1e-12,
    ),
    Definition(
        "tau_mean_abs", DEPLOYMENT, FORCE_UNIT, "lower", "Mean |force|",
        "mean absolute commanded force", "Mean absolute force when deployed", wide=True,
    ),
    Definition(
        "tau_fb_mean_abs", DEPLOYMENT, FORCE_UNIT, "lower", "Mean |feedback force|",
        "mean absolute part of the commanded force that is feedback", wide=True,
    ),
    Definition(
        "power_mean", DEPLOYMENT, POWER, "lower", "Mean power",
        "mean of |force times velocity|, in the plane or about the down axis",
        "Mean power when deployed", wide=True,
    ),
    Definition(
        "iaew", DEPLOYMENT, {"position": "m J s", "heading": "rad J s"}, "lower", "IAEW",
        "integral of the absolute error times the integral of the power",
        "Integral of absolute error times work", wide=True,
    ),
    Definition(
        "error_mae", DEPLOYMENT, POSE_IN_DEGREES, "lower", "Pose MAE",
        "mean absolute error of the pose against its reference, by axis",
        "Pose error by axis when deployed",
    ),
    Definition(
        "error_mse", DEPLOYMENT, _each(POSE_IN_DEGREES, "{}^2"), "lower", "Pose MSE",
        "mean square error of the pose against its reference, by axis", resolution=1e-12,
    ),
    Definition(
        "iae", DEPLOYMENT, _each(POSE_IN_DEGREES, "{} s"), "lower", "IAE",
        "integral of the absolute error of the pose",
    ),
    Definition(
        "itae", DEPLOYMENT, _each(POSE_IN_DEGREES, "{} s^2"), "lower", "ITAE",
        "integral of the absolute error of the pose times the time since the set-point last moved",
    ),
    Definition(
        "steady_state_error", DEPLOYMENT, POSE_IN_DEGREES, "lower", "Steady-state error",
        "largest |mean error| over the last 60 s of the stretches with a constant set-point",
        "Steady-state error when deployed",
    ),
    Definition(
        "overshoot", DEPLOYMENT, "%", "lower", "Overshoot",
        "largest overshoot of the set-point steps, of the step's size",
    ),
    Definition(
        "rise_time", DEPLOYMENT, "s", "lower", "Rise time",
        "mean time from 10 to 90 % of a set-point step",
    ),
    Definition(
        "settling_time", DEPLOYMENT, "s", "lower", "Settling time",
        "mean time until the pose stays within 5 % of a set-point step",
    ),
    Definition(
        "settling_time_first", DEPLOYMENT, "s", "lower", "Settling time, first step",
        "time until the pose stays within 5 % of the first set-point step",
    ),
    Definition(
        "settling_time_last", DEPLOYMENT, "s", "lower", "Settling time, last step",
        "time until the pose stays within 5 % of the last set-point step",
    ),
    Definition(
        "early_share", DEPLOYMENT, "%", "lower", "Early share",
        "mean share of a set-point step that is made in the 10 s before it",
    ),
    Definition(
        "tau_max_abs", DEPLOYMENT, FORCE_UNIT, "lower", "Largest |force|",
        "largest absolute commanded force",
    ),
    Definition(
        "tau_rms", DEPLOYMENT, FORCE_UNIT, "lower", "RMS force",
        "root mean square of the commanded force",
    ),
    Definition(
        "tau_tv", DEPLOYMENT, FORCE_UNIT, "lower", "Total variation of the force",
        "sum of the absolute changes of the commanded force",
    ),
    Definition(
        "limit_hits", DEPLOYMENT, "", "lower", "Samples at the limit",
        "number of samples at which the commanded force is at its limit",
    ),
    Definition(
        "energy", DEPLOYMENT, ENERGY, "lower", "Energy",
        "integral of |force times velocity|, in the plane or about the down axis",
    ),
    Definition(
        "failures", DEPLOYMENT, "", "lower", "Failures of the controller",
        "number of commands that the controller could not compute, the last one being held",
    ),
    Definition(
        "held_commands", DEPLOYMENT, "", "lower", "Held commands",
        "number of samples at which a command was not a number, so that the last one was held",
    ),
    Definition(
        "step_time_median", DEPLOYMENT, "us", "lower", "Step time, median",
        "median time to compute one step of the controller",
    ),
    Definition(
        "step_time_p99", DEPLOYMENT, "us", "lower", "Step time, 99th percentile",
        "99th percentile of the time to compute one step of the controller",
    ),
    Definition(
        "spectral_radius", DEPLOYMENT, "", "lower", "Spectral radius",
        "largest |eigenvalue| of the closed loop on the controller's own model; stable below 1",
    ),
    Definition(
        "infeasible_limits", DEPLOYMENT, "", "lower", "Infeasible limits",
        "1 where the weather needs more force than the limits give",
    ),
    Definition(
        "unreached_share", ("identification", "deployment"), "", "lower", "Unreached share",
        "share of the commanded forces that the thrusters cannot give",
    ),
    Definition(
        "integrated_velocity_error_max", IDENTIFICATION, POSE_UNIT, "lower",
        "Largest error of the integrated velocity",
        "largest |measured pose - integral of the measured velocity|",
    ),
    Definition(
        "differentiated_position_error_max", IDENTIFICATION, VELOCITY_UNIT, "lower",
        "Largest error of the differentiated pose",
        "largest |measured velocity - derivative of the measured pose|",
    ),
)  # fmt: skip
MEASURE_LOW, MEASURE_HIGH = "manoeuvre_low", "manoeuvre_high"  # diagnostics: a 90 % interval


def metric_of_measure(quantity: str) -> str:
    """Return the name of the metric of a quantity on the sheet of a manoeuvre."""
    return "manoeuvre_" + quantity.replace(",", "").replace(" ", "_").lower()


MANOEUVRE = tuple(
    Definition(
        metric_of_measure(quantity), VALIDATION, unit, None, quantity.capitalize(),
        f"{quantity} of the trial's manoeuvre in calm water",
    )
    for quantity, unit in MEASURES.items()
)  # fmt: skip
_declared: dict[str, Definition] = {}


def register(definition: Definition) -> Definition:
    """Declare a metric and return it.

    Raises ValueError for a name with other characters than small letters, digits and _, and for a
    name that has another definition.
    """
    name = definition.name
    if not re.fullmatch(r"[a-z][a-z0-9_]*", name):
        raise ValueError(f"metric: got name {name!r}, expected small letters, digits and _")
    if _declared.setdefault(name, definition) != definition:
        raise ValueError(f"metric {name}: got a second definition, expected one")
    return definition


for _definition in (*METRICS, *MANOEUVRE):
    register(_definition)


def declared(name: str) -> Definition:
    """Return the definition of a metric; raises KeyError if it is not declared."""
    if name not in _declared:
        raise KeyError(
            f"metric {name}: got no definition, expected it in catalogue.METRICS or registered"
        )
    return _declared[name]


def all_declared() -> tuple[Definition, ...]:
    """Return every declared metric, those of this module first."""
    return tuple(_declared.values())


def definition_of(name: str) -> Definition:
    """Return the definition of a stored metric; for an undeclared one, its name only."""
    return _declared.get(name) or Definition(name, (), "", None, name, "")
