"""The catalogue of metrics: every metric that a trial stores is a row of `metrics.csv`.

A row gives the name of a metric, the stages that store it, its unit, which values are better, and
its definition in words; what is empty there has the default of `Definition`. A unit `m|rad` is that
of displacements and that of rotations. Stored rows, the database's views, tables, figures, reports
and the command `seatrial-results metrics` read the catalogue. A user-defined metric is declared
with `register` in its own module. An undeclared metric in a database is shown with its stored unit,
and no value is marked as better.
"""

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from seatrial.models.notation import DOFS, MEASURES
from seatrial.runner.record.vocabulary import DOF_ORDER, SAILED, Stage

Unit = str | Mapping[str, str]
Better = Literal["lower", "higher"] | float | None
QUANTITIES = ("pose", "velocity")  # that are predicted, and over which horizons
HORIZONS = ("one_step", "ten_step", "restarts", "free_run")
# The metrics of a trial that matter, and how many lines of them are shown; docking comes first.
HEADLINES = (
    *("contacts", "smallest_clearance", "time_to_berth", "final_position_error"),
    *("final_heading_error", "e_pos_mae", "e_psi_mae", "velocity_rmse_restarts"),
)
MOST_HEADLINES = 5


@dataclass(frozen=True)
class Definition:
    """The definition of a metric.

    `stages` are the stages of a trial that store it. `unit` is one unit, or a unit per degree of
    freedom. `better` is `lower`, `higher`, a target value, or None if no value is better. `label`
    names the metric on axes, `formula` defines it in words, `caption` is the heading of its table
    in a report (by default the label), and `note` is printed under every table that shows it. A
    `wide` metric is a column of the view `metric_wide`; a metric with a `headline` is a column of
    `run_overview`, for that degree of freedom. A `score` has no natural zero: it is compared by
    differences, not by ratios. Values that differ by less than the `resolution` are equal. Those of
    the table that are `per_file` are also stored for each of several files that are tested on.
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
    per_file: bool = False

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


def _of_row(row: Mapping[str, Any]) -> Definition:
    """The definition in a row of the table."""
    unit: Unit = row["unit"]
    if "|" in unit:
        linear, angular = row["unit"].split("|")
        unit = {dof: linear if dof in DOFS[:3] else angular for dof in DOFS}
    elif ": " in unit:
        unit = dict(part.split(": ") for part in row["unit"].split("; "))
    return Definition(
        row["name"], tuple(row["stages"].split()), unit, row["better"] or None, row["label"],
        row["formula"], row["caption"], row["note"], bool(row["wide"]), row["headline"],
        bool(row["score"]), float(row["resolution"] or Definition.resolution),
        bool(row["per_file"]),
    )  # fmt: skip


with Path(__file__).with_name("metrics.csv").open(encoding="utf-8", newline="") as _file:
    METRICS = tuple(map(_of_row, csv.DictReader(_file)))
PER_FILE = tuple(one.name for one in METRICS if one.per_file)


def metric_of_measure(quantity: str) -> str:
    """Return the name of the metric of a quantity on the sheet of a manoeuvre."""
    return "manoeuvre_" + quantity.replace(",", "").replace(" ", "_").lower()


_declared = {one.name: one for one in METRICS}


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


for _quantity, _unit in MEASURES.items():
    register(
        Definition(
            metric_of_measure(_quantity), ("validation",), _unit, None, _quantity.capitalize(),
            f"{_quantity} of the trial's manoeuvre in calm water",
        )
    )  # fmt: skip


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


def headlines(stored: Sequence[Any]) -> list[list[Any]]:
    """Return the rows of a trial that matter (`rows.Metric`), of each of SAILED; None: no row."""
    numbers = {(row.name, row.dof, row.model): row for row in stored}
    places = [(name, dof) for name in HEADLINES for dof in DOF_ORDER]
    pairs = [[numbers.get((*place, model)) for model in SAILED] for place in places]
    return [pair for pair in pairs if any(pair)][:MOST_HEADLINES]
