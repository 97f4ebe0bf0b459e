"""An identifier that is a command: another program, in any language, finds the coefficients.

The program reads `problem.json` and the recording that it names, and writes `coefficients.json` or
`coefficients.csv`: the coefficients of tau[dof] = sum_k theta[k, dof] phi_k in SI units.
docs/howto/plugins.md describes these files.
"""

import csv
import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from math import isfinite, nan
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

import numpy as np

from seatrial.models.errors import ConfigurationError, PartError, SeatrialError
from seatrial.models.identification.problem import Identified, Identifier, Problem
from seatrial.models.ranges import Positive, check_ranges
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag
from seatrial.runner.database.series_files import parquet_of
from seatrial.runner.record.rows import Series
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


PRIVATE = ("SEATRIAL_DATABASE",)  # variables that the program has no need to know
# A pipe that is closed without a word is that of a process that was killed.
WATCH = "import os, sys; sys.stdin.read() or os.killpg(int(sys.argv[1]), 9)"
TAIL = 2000  # bytes of its messages that are read
SHOWN = 200  # characters of its last message


@dataclass(frozen=True)
class CommandIdentifier(Identifier):
    """Runs a command in the working folder, with the folder of the problem as its last argument.

    `limit_s` [s] is the longest time that it may take.
    """

    command: tuple[str, ...] | None = None
    limit_s: Positive = 600.0
    recording: Format = "parquet"
    files: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_ranges(self)

    def check(self, nominal: Vessel, thruster: SecondOrderLag | None, measured: bool) -> None:
        """Raise ConfigurationError for a command that is not installed, and for missing files."""
        if not self.command:
            raise ConfigurationError(
                "identifier.command: got none, expected a list such as [python, fit.py]"
            )
        if shutil.which(self.command[0]) is None:
            raise ConfigurationError(
                f"identifier.command: got {self.command[0]!r}, expected a program that is installed"
            )
        for name in self.files:
            if not Path(name).is_file():
                raise ConfigurationError(f"identifier.files: got {name!r}, expected a file")

    def identify(self, problem: Problem, rng: np.random.Generator) -> Identified:
        """The nominal model with the coefficients of the program; raises PartError."""
        with TemporaryDirectory(prefix="seatrial-", ignore_cleanup_errors=True) as name:
            folder = Path(name)
            write_problem(folder, problem, int(rng.integers(2**31)), self.recording)
            try:
                self._run(folder)
                return identified(read_answer(folder, problem.nominal), problem.nominal)
            except PartError as error:
                raise PartError(f"{shlex.join(self.command or ())}: {error}") from error

    def _run(self, folder: Path) -> None:
        """Run the command until it ends, or the limit; nothing that it started remains."""
        messages = folder / "messages.txt"
        environment = {name: text for name, text in os.environ.items() if name not in PRIVATE}
        with messages.open("wb") as output:
            try:
                process = subprocess.Popen(
                    [*(self.command or ()), str(folder)],
                    stdin=subprocess.DEVNULL, stdout=output, stderr=output,
                    env=environment, start_new_session=True,
                )  # fmt: skip
            except OSError as error:
                raise PartError(f"cannot be started: {error.strerror}") from error
            try:
                with _ended_with_this_process(process.pid):
                    code = process.wait(self.limit_s)
            except subprocess.TimeoutExpired:
                raise PartError(
                    f"took longer than identifier.limit_s = {self.limit_s:g} s"
                ) from None
            finally:
                _end(process)
        if code:
            ended = f"exit code {code}" if code > 0 else f"ended by signal {-code}"
            raise PartError(f"{ended}: {_last_line(messages)}")


@contextmanager
def _ended_with_this_process(group: int) -> Iterator[None]:
    """Let another process end a group of processes if this one is killed, as a worker may be."""
    watch = subprocess.Popen(
        [sys.executable, "-I", "-S", "-c", WATCH, str(group)],
        stdin=subprocess.PIPE,
        start_new_session=True,
    )
    try:
        yield
    finally:
        watch.communicate(b"ended")


def _end(process: "subprocess.Popen[bytes]") -> None:
    """End all processes of the command's group, and wait for the command."""
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def _last_line(messages: Path) -> str:
    """Return the last line that the program has printed."""
    with messages.open("rb") as file:
        file.seek(max(0, messages.stat().st_size - TAIL))
        lines = file.read().decode(errors="replace").split("\n")
    said = [" ".join(line.split()) for line in lines if line.strip()]
    return said[-1][:SHOWN] if said else "no message"
