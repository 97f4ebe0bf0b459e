"""The sheet of a standard manoeuvre: of a stored run, or of a file of recorded motion."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import Manoeuvre
from seatrial.runner.compare.frame import FINISHED, Queries, StoredRun
from seatrial.runner.compare.grid import Scalar, TextTable, grid_of, number_text
from seatrial.runner.export import manoeuvre_tracks as tracks
from seatrial.runner.export.manoeuvre_tracks import manoeuvre_sheet as sheets

EXECUTED = "from the instant at which the helm has passed half of its first step"
VISIBLE = 1e-3  # width of an interval over its value
MAX_MANOEUVRES = 6  # manoeuvres in a report


def run_sheet(
    results: Queries, run: int, manoeuvre: Manoeuvre | None, helm: str | None,
    length_m: float | None, scale: float,
) -> TextTable:  # fmt: skip
    """Return the sheet of a run, or the measures that are stored of its recorded manoeuvres."""
    predicted = [
        row for row in results.reader.diagnostics(run) if row.name.startswith(sheets.DIAGNOSTIC)
    ]
    if predicted:
        return comparison(predicted, f"Run {run}")
    recorded = tracks.stored(results.reader, run, helm, length_m)
    return sheet_of(recorded, f"Run {run}", manoeuvre, scale)


def newest_manoeuvres(
    results: Queries, runs: Sequence[StoredRun], kinds: Sequence[str] = tracks.MANOEUVRES
) -> list[tuple[StoredRun, tracks.Recorded]]:
    """The newest finished run of each vessel and excitation that is one of the manoeuvres."""
    newest = {
        (run.levels["vessel"], run.levels["excitation"]): run
        for run in runs
        if run.status == FINISHED
    }
    chosen = sorted(newest.values(), key=lambda run: -run.id)
    configs = results.configs_of([run.id for run in chosen])
    found = [run for run in chosen if configs[run.id].get("excitation.manoeuvre") in kinds]
    known = []
    for run in found[:MAX_MANOEUVRES]:
        with suppress(ConfigurationError):  # of a vessel without a position, such as in yaw alone
            known.append((run, tracks.stored(results.reader, run.id)))
    return known


def sheet_of(
    recorded: tracks.Recorded, title: str, kind: Manoeuvre | None = None, scale: float = 1.0
) -> TextTable:
    """The sheet of a recorded manoeuvre as a table, with its definitions below."""
    track, ordered = recorded
    result = sheets.measured_sheet(track, replace(ordered, kind=kind or ordered.kind), scale)
    noisy = any(  # an interval is wide enough to be seen in the table
        entry.high - entry.low > VISIBLE * abs(entry.value) for entry in result.entries
    )
    headers = ["quantity", "value", *(["from", "to"] if noisy else []), "unit", "metres", "limit"]
    headers += ["MSC.137(76)"]
    rows: list[list[Scalar]] = []
    for entry in result.entries:
        metres = entry.value * result.length_m if entry.unit == "L" else None
        rows.append([entry.quantity, entry.value, *([entry.low, entry.high] if noisy else [])])
        rows[-1] += [entry.unit, metres, entry.limit, entry.verdict]
    notes = notes_of(result)
    if noisy:
        notes.append("from, to: 90 % interval, due to noise and sample time of the recording")
    return grid_of(f"{title}: {result.manoeuvre.replace('_', ' ')}", headers, rows, notes=notes)


def comparison(rows: Sequence[Diagnostic], title: str) -> TextTable:
    """The measures of recorded manoeuvres, and those of the predictions that the run has stored."""
    lines: dict[tuple[str, str], list[Diagnostic]] = {}
    for row in rows:
        file = (row.label or "").rpartition(", ")[0]
        quantity = row.name.removeprefix(sheets.DIAGNOSTIC).replace("_", " ")
        lines.setdefault((file, quantity), []).append(row)
    table: list[list[Scalar]] = []
    for (file, quantity), own in lines.items():
        values: dict[int | None, float | None] = {row.j: row.value for row in own}
        measured, nominal, identified, low, high = (
            values.get(j) for j in range(len(sheets.COMPARED))
        )
        error = None
        if measured and identified is not None:
            error = 100.0 * (identified / measured - 1.0)
        table.append([file, quantity, own[0].unit, measured, nominal, identified, error, low, high])
    headers = ("file", "quantity", "unit", *sheets.COMPARED[:3], "error [%]", *sheets.COMPARED[3:])
    notes = [f"{EXECUTED}; L: ship lengths"]
    notes.append(
        "low, high: 90 % of simulations with parameters drawn from their covariance and with the"
        " model error, if there is one (show: model_error, no_model_error)"
    )
    return grid_of(f"{title}: manoeuvres", headers, table, labels=3, notes=notes)


def notes_of(result: sheets.Sheet) -> list[str]:
    """What the quantities are measured from."""
    notes = [] if "spiral" in result.manoeuvre else [EXECUTED]
    length, speed = number_text(result.length_m, 5), number_text(result.speed_m_s, 4)
    ratio = number_text(result.length_over_speed_s, 3)
    if not any(entry.limit is not None for entry in result.entries):
        notes.append(sheets.UNLIMITED)
    scaled = result.length_over_speed_s * result.speed_m_s > 1.0001 * result.length_m
    where = " at full scale" if scaled else ""  # with --scale alone it is not that of the model
    return [*notes, f"L = {length} m, approach at {speed} m/s, L/V{where} {ratio} s"]
