"""The sheet of a standard manoeuvre: of a stored run, or of a file of recorded motion."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from seatrial.runner.compare.grid import Grid, Scalar, grid_of, number_text
from seatrial.runner.compare.results import FINISHED, Results, Run, open_results
from seatrial.runner.export.manoeuvre_tracks import (
    INSTANTS,
    MANOEUVRES,
    Entry,
    Execution,
    Manoeuvre,
    Recorded,
    Sheet,
    file_track,
    sheet,
    stored,
)

RECORDING = "recording"
MOST = 6  # manoeuvres in a report


@dataclass(frozen=True)
class SheetRequest:
    """What `manoeuvres` was asked for."""

    subject: str  # number of a run, or path of a file
    execution: Execution
    manoeuvre: Manoeuvre | None
    helm: str | None
    length_m: float | None
    scale: float
    columns: str | None
    series: str


def sheet_grid(request: SheetRequest, database: str, results_dir: Path | None) -> Grid:
    """The sheet of a run or a file as a table."""
    path = Path(request.subject)
    if request.subject.isdigit() and not path.exists():
        with open_results(database, results_dir) as results:
            recorded = stored(
                results.reader, int(request.subject), request.series, request.helm, request.length_m
            )
        title = f"Run {request.subject}"
    else:
        recorded, title = (
            Recorded(file_track(path, request.columns, request.length_m), None),
            str(path),
        )
    manoeuvre = request.manoeuvre or recorded.manoeuvre
    return grid_of_sheet(sheet(recorded.track, manoeuvre, request.execution, request.scale), title)


def newest_manoeuvres(
    results: Results, runs: Sequence[Run], kinds: Sequence[str] = MANOEUVRES
) -> list[tuple[Run, Recorded]]:
    """The newest finished run of each vessel and excitation that is one of the manoeuvres."""
    finished = [run for run in runs if run.status == FINISHED]
    newest = {(run.levels["vessel"], run.levels["excitation"]): run for run in finished}
    chosen = sorted(newest.values(), key=lambda run: -run.id)
    configs = results.configs_of([run.id for run in chosen])
    key = "excitation.manoeuvre"
    found = [run for run in chosen if configs.get(run.id, {}).get(key) in kinds][:MOST]
    return [(run, stored(results.reader, run.id, RECORDING)) for run in found]


def grid_of_sheet(result: Sheet, title: str) -> Grid:
    """The sheet as a table with its definitions below."""
    rows = [_row(entry, result.length_m) for entry in result.entries]
    headers = ("quantity", "value", "unit", "metres", "limit", "MSC.137(76)")
    return grid_of(
        f"{title}: {result.manoeuvre.replace('_', ' ')}", headers, rows, notes=notes_of(result)
    )


def _row(entry: Entry, length_m: float) -> list[Scalar]:
    verdict = {True: "pass", False: "fail", None: None}[entry.passed]
    metres = entry.value * length_m if entry.unit == "L" else None
    return [entry.quantity, entry.value, entry.unit, metres, entry.limit, verdict]


def notes_of(result: Sheet) -> list[str]:
    """What the quantities are measured from."""
    instant = INSTANTS[result.execution]
    notes = [] if "spiral" in result.manoeuvre else [f"from {instant} ({result.execution})"]
    length, speed = number_text(result.length_m, 5), number_text(result.speed_m_s, 4)
    ratio = number_text(result.length_over_speed_s, 3)
    return [*notes, f"L = {length} m, approach at {speed} m/s, L/V at full scale {ratio} s"]
