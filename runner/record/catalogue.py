"""The catalogue of metrics: every metric that a trial stores is declared here once.

A declaration gives the name of a metric, its unit for each degree of freedom, which values are
better, and its definition in words. Those of predictions are made here, the others are the rows of
`metrics.csv`; what is empty there has the default of `Definition`. Stored rows, the database's
views, tables, figures, reports and the command `seatrial-results metrics` read it. A user-defined
metric is declared with `register` in its own module. An undeclared metric in a database is shown
with its stored unit, and no value is marked as better.
"""

import csv
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, cast

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
TABLE = Path(__file__).with_name("metrics.csv")


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
POSE_IN_DEGREES = {dof: "m" if unit == "m" else "deg" for dof, unit in POSE_UNIT.items()}
UNITS = {  # what the table calls `force of each axis`
    "pose": POSE_UNIT,
    "pose in degrees": POSE_IN_DEGREES,
    "pose in degrees squared": _each(POSE_IN_DEGREES, "{}^2"),
    "pose in degrees times s": _each(POSE_IN_DEGREES, "{} s"),
    "pose in degrees times s^2": _each(POSE_IN_DEGREES, "{} s^2"),
    "velocity": VELOCITY_UNIT,
    "velocity squared": _each(VELOCITY_UNIT, "({})^2"),
    "acceleration squared": _each(ACCELERATION_UNIT, "({})^2"),
    "force": FORCE_UNIT,
    "force squared": SQUARE_UNIT,
}
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


def _unit(text: str) -> Unit:
    """The unit of a row of the table: of each axis, of those that it names, or one of all."""
    quantity, of_each, _ = text.partition(" of each axis")
    if of_each:
        return UNITS[quantity]
    pairs = [part.partition(": ") for part in text.split("; ")]
    return {dof: unit for dof, _, unit in pairs} if ": " in text else text


def _of_row(row: Mapping[str, str]) -> Definition:
    return Definition(
        row["name"], cast(tuple[Stage, ...], tuple(row["stages"].split())), _unit(row["unit"]),
        cast(Better, row["better"] or None), row["label"], row["formula"], row["caption"],
        wide=row["wide"] == "yes", headline=row["headline"],
        resolution=float(row["resolution"] or Definition.resolution),
    )  # fmt: skip


with TABLE.open(encoding="utf-8", newline="") as _file:
    _TABLED = [*map(_of_row, csv.DictReader(_file))]
METRICS = (
    *(one for one in _TABLED if one.stages == VALIDATION),
    *_predictions(),
    *(one for one in _TABLED if one.stages != VALIDATION),
)


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
