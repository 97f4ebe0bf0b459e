"""The files that an identification by another program reads and writes: docs/howto/plugins.md.

The program reads `problem.json` and the recording that it names, and writes `coefficients.json` or
`coefficients.csv`: the coefficients of tau[dof] = sum_k theta[k, dof] phi_k in SI units.
"""

import csv
import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from math import isfinite, nan
from pathlib import Path
from typing import Literal

import numpy as np

from seatrial.models.errors import PartError, SeatrialError
from seatrial.models.identification.problem import Identified, Problem
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel
from seatrial.runner.database.records import Series
from seatrial.runner.database.series_files import parquet_of
from seatrial.runner.record.time_series import training_series

VERSION = 1  # of these files
LARGEST = 10_000_000  # bytes of the coefficients
ANSWERS = ("coefficients.json", "coefficients.csv")
COLUMNS = ("term", "dof", "value", "std_error")
Format = Literal["parquet", "csv"]


@dataclass(frozen=True)
class Row:
    """A coefficient that the program has written."""

    term: basis.Term
    dof: str
    value: float
    std_error: float  # NaN: not estimated


def write_problem(folder: Path, problem: Problem, seed: int, form: Format) -> None:
    """Write the recording and the prior knowledge of the vessel to a folder."""
    series, nominal = training_series(problem.training), problem.nominal
    recording = folder / f"recording.{form}"
    if form == "parquet":
        recording.write_bytes(parquet_of(series))
    else:
        _write_csv(recording, series)
    content = {
        "version": VERSION,
        "vessel": nominal.name,
        "dofs": nominal.dofs,
        "sample_time_s": problem.training.period_s,
        "seed": seed,
        "recording": recording.name,
        "columns": series.units,
        "nominal": [
            {"term": term.name, "dof": dof, "value": float(value), "unit": nominal.unit(term, dof)}
            for term, row in zip(nominal.terms, nominal.theta, strict=True)
            for dof, value in zip(nominal.dofs, row, strict=True)
            if value
        ],
        "thruster": None if problem.thruster is None else asdict(problem.thruster),
    }
    (folder / "problem.json").write_text(json.dumps(content, indent=1))


def _write_csv(path: Path, series: Series) -> None:
    columns = np.column_stack(list(series.columns.values()))
    header = ",".join(series.columns)
    np.savetxt(path, columns, fmt="%.17g", delimiter=",", header=header, comments="")


def read_answer(folder: Path, nominal: Vessel) -> list[Row]:
    """Read the coefficients that the program has written; raises PartError if they are none."""
    files = [folder / name for name in ANSWERS if (folder / name).is_file()]
    if len(files) != 1:
        got = "both" if files else "none"
        raise PartError(f"got {got} of {' and '.join(ANSWERS)}, expected one")
    (path,) = files
    size = path.stat().st_size
    if size > LARGEST:
        raise PartError(f"{path.name}: got {size} bytes, expected at most {LARGEST}")
    try:
        text = path.read_text(encoding="utf-8-sig")
        rows = (
            _json_rows(text) if path.suffix == ".json" else list(csv.DictReader(text.splitlines()))
        )
        return _checked(rows, nominal)
    except (ValueError, RecursionError, csv.Error, SeatrialError) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise PartError(f"{path.name}: {reason}") from error


def _json_rows(text: str) -> list[object]:
    content = json.loads(text)
    rows = content.get("coefficients") if isinstance(content, dict) else content
    if not isinstance(rows, list):
        raise ValueError("got no list `coefficients`, expected one")
    return rows


def _checked(rows: Iterable[object], nominal: Vessel) -> list[Row]:
    result: dict[tuple[basis.Term, str], Row] = {}
    for number, row in enumerate(rows, 1):
        where = f"coefficient {number}"
        if not isinstance(row, Mapping) or not set(COLUMNS[:3]) <= set(row) <= set(COLUMNS):
            raise ValueError(f"{where}: got {_shown(row)}, expected term, dof, value")
        if row["dof"] not in nominal.dofs:
            expected = ", ".join(nominal.dofs)
            raise ValueError(f"{where}: dof: got {_shown(row['dof'])}, expected one of {expected}")
        term = basis.term(str(row["term"]))
        missing = row.get("std_error") in (None, "")
        error = nan if missing else _number(row["std_error"], f"{where}: std_error")
        value = _number(row["value"], f"{where}: value")
        key = term, str(row["dof"])
        if key in result:
            raise ValueError(f"{where}: got {term.name} in {key[1]} twice")
        result[key] = Row(*key, value, error)
    if not result:
        raise ValueError("got no coefficients, expected at least one")
    return list(result.values())


def _number(value: object, where: str) -> float:
    try:
        number = nan if isinstance(value, bool) else float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        number = nan
    if not isfinite(number):
        raise ValueError(f"{where}: got {_shown(value)}, expected a finite number")
    return number


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def identified(rows: Iterable[Row], nominal: Vessel) -> Identified:
    """Return the nominal model with the coefficients of the rows; others keep their values."""
    rows = list(rows)
    new = dict.fromkeys(row.term for row in rows if row.term not in nominal.terms)
    terms = (*nominal.terms, *new)
    theta: Array = np.array(nominal.on(terms).theta)
    errors = np.full(theta.shape, nan)
    for row in rows:
        place = terms.index(row.term), nominal.dofs.index(row.dof)
        theta[place], errors[place] = row.value, row.std_error
    model = Vessel(nominal.name, nominal.dofs, terms, theta, nominal.attitude)
    return Identified(model, model - nominal, std_error=errors)
