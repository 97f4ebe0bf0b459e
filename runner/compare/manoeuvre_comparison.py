"""The sheet of a standard manoeuvre: of a stored run, or of a file of recorded motion."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.frame import FINISHED, Queries, StoredRun
from seatrial.runner.compare.grid import Scalar, TextTable, grid_of, number_text
from seatrial.runner.export.manoeuvre_tracks import (
    COMPARED,
    DIAGNOSTIC,
    INSTANTS,
    MANOEUVRES,
    Execution,
    Manoeuvre,
    PredictedMeasure,
    Recorded,
    Sheet,
    file_track,
    measured_sheet,
    stored,
)

RECORDING = "recording"
STORED: Execution = "half"  # instant of execution of what is stored of the models
VISIBLE = 1e-3  # width of an interval over its value
MAX_MANOEUVRES = 6  # manoeuvres in a report


def run_sheet(
    results: Queries, run: int, series: str, execution: Execution, manoeuvre: Manoeuvre | None,
    helm: str | None, length_m: float | None, scale: float,
) -> TextTable:  # fmt: skip
    """Return the sheet of a run, or the measures that are stored of its recorded manoeuvres."""
    predicted = [row for row in results.reader.diagnostics(run) if row.name.startswith(DIAGNOSTIC)]
    if predicted and series == RECORDING:
        return comparison(predicted, f"Run {run}")
    recorded = stored(results.reader, run, series, helm, length_m)
    ordered = replace(recorded.ordered, kind=manoeuvre or recorded.ordered.kind)
    result = measured_sheet(recorded.track, ordered, execution, scale)
    return grid_of_sheet(result, f"Run {run}", recorded.predicted)


def file_sheet(
    path: Path, map_file: Path | None, execution: Execution, manoeuvre: Manoeuvre | None,
    helm: str | None, length_m: float | None, scale: float,
) -> TextTable:  # fmt: skip
    """Return the sheet of a recorded file."""
    track, ordered = file_track(path, map_file, helm, length_m)
    ordered = replace(ordered, kind=manoeuvre or ordered.kind)
    result = measured_sheet(track, ordered, execution, scale)
    return grid_of_sheet(result, str(path))


def newest_manoeuvres(
    results: Queries, runs: Sequence[StoredRun], kinds: Sequence[str] = MANOEUVRES
) -> list[tuple[StoredRun, Recorded]]:
    """The newest finished run of each vessel and excitation that is one of the manoeuvres."""
    finished = [run for run in runs if run.status == FINISHED]
    newest = {(run.levels["vessel"], run.levels["excitation"]): run for run in finished}
    chosen = sorted(newest.values(), key=lambda run: -run.id)
    configs = results.configs_of([run.id for run in chosen])
    key = "excitation.manoeuvre"
    found = [run for run in chosen if configs.get(run.id, {}).get(key) in kinds][:MAX_MANOEUVRES]
    known = []
    for run in found:
        try:
            known.append((run, stored(results.reader, run.id, RECORDING)))
        except ConfigurationError:  # of a vessel that has no position, such as one in yaw alone
            continue
    return known


def grid_of_sheet(
    result: Sheet, title: str, predicted: Mapping[str, PredictedMeasure] | None = None
) -> TextTable:
    """The sheet as a table with its definitions below.

    `predicted` are the quantities that the identified model predicts.
    """
    known = dict(predicted or {}) if result.execution == STORED else {}
    values = {entry.quantity: entry.value for entry in result.entries}
    if not any(  # a prediction that differs from the measure, or has an interval, says more
        np.isfinite(low) or not np.isclose(value, values[name], rtol=1e-9)
        for name, (value, low, _) in known.items()
        if name in values
    ):
        known = {}
    noisy = any(  # an interval is wide enough to be seen in the table
        entry.low is not None
        and entry.high is not None
        and entry.high - entry.low > VISIBLE * abs(entry.value)
        for entry in result.entries
    )
    rows: list[list[Scalar]] = []
    for entry in result.entries:
        bounds = [entry.low, entry.high] if noisy else []
        metres = entry.value * result.length_m if entry.unit == "L" else None
        row = [entry.quantity, entry.value, *bounds, entry.unit, metres, entry.limit, entry.verdict]
        if known:
            own = known.get(entry.quantity, (None,) * 3)
            row += [None if value is None or np.isnan(value) else value for value in own]
        rows.append(row)
    headers = ["quantity", "value", *(["from", "to"] if noisy else []), "unit", "metres", "limit"]
    headers.append("MSC.137(76)")
    notes = notes_of(result)
    if noisy:
        notes.append("from, to: 90 % interval, due to noise and sample time of the recording")
    if known:
        headers += ["identified", "90 % from", "90 % to"]
        notes.append("identified: the model's own manoeuvre in calm water, with its 90 % interval")
    return grid_of(f"{title}: {result.manoeuvre.replace('_', ' ')}", headers, rows, notes=notes)


def comparison(rows: Sequence[Diagnostic], title: str) -> TextTable:
    """The measures of recorded manoeuvres, and those of the predictions that the run has stored."""
    lines: dict[tuple[str, str], list[Diagnostic]] = {}
    for row in rows:
        file = (row.label or "").rpartition(", ")[0]
        quantity = row.name.removeprefix(DIAGNOSTIC).replace("_", " ")
        lines.setdefault((file, quantity), []).append(row)
    table: list[list[Scalar]] = []
    for (file, quantity), own in lines.items():
        values: dict[int | None, float | None] = {row.j: row.value for row in own}
        measured, nominal, identified, low, high = (values.get(j) for j in range(len(COMPARED)))
        error = None
        if measured and identified is not None:
            error = 100.0 * (identified / measured - 1.0)
        table.append([file, quantity, own[0].unit, measured, nominal, identified, error, low, high])
    headers = ("file", "quantity", "unit", *COMPARED[:3], "error [%]", *COMPARED[3:])
    notes = [f"from {INSTANTS['half']} (half); L: ship lengths"]
    notes.append(
        "low, high: 90 % of simulations with parameters drawn from their covariance and with the"
        " model error, if there is one (show: model_error, no_model_error)"
    )
    return grid_of(f"{title}: manoeuvres", headers, table, labels=3, notes=notes)


def notes_of(result: Sheet) -> list[str]:
    """What the quantities are measured from."""
    instant = INSTANTS[result.execution]
    notes = [] if "spiral" in result.manoeuvre else [f"from {instant} ({result.execution})"]
    length, speed = number_text(result.length_m, 5), number_text(result.speed_m_s, 4)
    ratio = number_text(result.length_over_speed_s, 3)
    if result.unlimited:
        notes.append(result.unlimited)
    scaled = result.length_over_speed_s * result.speed_m_s > 1.0001 * result.length_m
    where = " at full scale" if scaled else ""  # with --scale alone it is not that of the model
    return [*notes, f"L = {length} m, approach at {speed} m/s, L/V{where} {ratio} s"]
