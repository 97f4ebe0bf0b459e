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
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import asdict, dataclass
from math import isfinite, isinf, nan
from pathlib import Path
from reprlib import repr as short
from tempfile import TemporaryDirectory
from typing import Any, Literal

import numpy as np

from seatrial.models.errors import ConfigurationError, PartError, SeatrialError
from seatrial.models.identification.problem import Identified, Identifier, Problem
from seatrial.models.ranges import Positive, check_ranges
from seatrial.models.vessel import basis
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag
from seatrial.runner.database.series_files import parquet_of
from seatrial.runner.record.time_series import training_series

VERSION = 1  # of these files
ANSWERS = ("coefficients.json", "coefficients.csv")
COLUMNS = ("term", "dof", "value", "std_error")


@dataclass(frozen=True)
class CommandIdentifier(Identifier):
    """Runs a command in the working folder, with the folder of the problem as its last argument.

    `limit_s` [s] is the longest time that it may take.
    """

    command: tuple[str, ...] = ()
    limit_s: Positive = 600.0
    recording: Literal["parquet", "csv"] = "parquet"
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
        """Return the nominal model with the coefficients of the program; raises PartError."""
        with TemporaryDirectory(prefix="seatrial-", ignore_cleanup_errors=True) as name:
            folder = Path(name)
            write_problem(folder, problem, int(rng.integers(2**31)), self.recording)
            try:
                self._run(folder)
                return identified(read_answer(folder), problem.nominal)
            except PartError as error:
                raise PartError(f"{shlex.join(self.command)}: {error}") from error

    def _run(self, folder: Path) -> None:
        """Run the command until it ends, or the limit; nothing that it started remains."""
        messages = folder / "messages.txt"
        with messages.open("wb") as output:
            try:
                process = subprocess.Popen(
                    [*self.command, str(folder)], stdin=subprocess.DEVNULL, stdout=output,
                    stderr=output, start_new_session=True,
                )  # fmt: skip
            except OSError as error:
                raise PartError(f"cannot be started: {error.strerror}") from error
            try:
                code = process.wait(self.limit_s)
            except subprocess.TimeoutExpired:
                limit = f"took longer than identifier.limit_s = {self.limit_s:g} s"
                raise PartError(limit) from None
            finally:
                with suppress(ProcessLookupError, PermissionError):
                    os.killpg(process.pid, signal.SIGKILL)
                process.wait()
        if code:
            said = messages.read_text(errors="replace").split("\n")
            last = next((" ".join(line.split()) for line in said[::-1] if line.strip()), "")
            ended = f"exit code {code}" if code > 0 else f"ended by signal {-code}"
            raise PartError(f"{ended}: {last[:200] or 'no message'}")


def write_problem(folder: Path, problem: Problem, seed: int, form: str) -> None:
    """Write the recording and the prior knowledge of the vessel to a folder."""
    series, nominal = training_series(problem.training), problem.nominal
    recording = folder / f"recording.{form}"
    if form == "parquet":
        recording.write_bytes(parquet_of(series))
    else:
        columns, header = np.column_stack([*series.columns.values()]), ",".join(series.columns)
        np.savetxt(recording, columns, "%.17g", ",", header=header, comments="")
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


def read_answer(folder: Path) -> list[Any]:
    """Read the rows that the program has written; raises PartError if it is no such file."""
    files = [folder / name for name in ANSWERS if (folder / name).is_file()]
    if len(files) != 1:
        got = "both" if files else "none"
        raise PartError(f"got {got} of {' and '.join(ANSWERS)}, expected one")
    (path,) = files
    try:
        text = path.read_text(encoding="utf-8-sig")
        rows = json.loads(text) if path.suffix == ".json" else [*csv.DictReader(text.splitlines())]
    except (ValueError, csv.Error) as error:
        raise PartError(f"{path.name}: {error}") from error
    rows = rows.get("coefficients") if isinstance(rows, dict) else rows
    if not isinstance(rows, list) or not rows:
        raise PartError(f"{path.name}: got no coefficients, expected at least one")
    return rows


def identified(rows: Iterable[Any], nominal: Vessel) -> Identified:
    """Return the nominal model with the coefficients of the rows; others keep their values.

    Each row has term, dof, value and maybe std_error. Raises PartError for one that has not.
    """
    found: dict[tuple[basis.Term, str], tuple[float, float]] = {}
    for number, row in enumerate(rows, 1):
        where = f"coefficient {number}: "
        try:
            if not set(row) <= set(COLUMNS):
                raise ValueError
            key, spread = (basis.term(row["term"]), str(row["dof"])), row.get("std_error")
            value = float(row["value"]), nan if spread in (None, "") else float(spread)
        except SeatrialError as error:
            raise PartError(f"{where}{error}") from error
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise PartError(f"{where}got {short(row)}, expected term, dof and value") from error
        if key[1] not in nominal.dofs:
            expected = ", ".join(nominal.dofs)
            raise PartError(f"{where}dof: got {key[1]!r}, expected one of {expected}")
        if not isfinite(value[0]) or isinf(value[1]):
            raise PartError(f"{where}got {short(row)}, expected finite numbers")
        if key in found:
            raise PartError(f"{where}got {key[0].name} in {key[1]} twice")
        found[key] = value
    terms = tuple(dict.fromkeys([*nominal.terms, *(term for term, _ in found)]))
    theta = np.array(nominal.on(terms).theta)
    errors = np.full(theta.shape, nan)
    for (term, dof), value in found.items():
        place = terms.index(term), nominal.dofs.index(dof)
        theta[place], errors[place] = value
    model = Vessel(nominal.name, nominal.dofs, terms, theta, nominal.attitude)
    return Identified(model, model - nominal, std_error=errors)
