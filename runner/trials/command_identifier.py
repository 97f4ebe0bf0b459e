"""An identifier that is a command: another program, in any language, finds the coefficients.

The program reads `problem.json` and `recording.csv`, and writes `coefficients.csv`: those of
tau[dof] = sum_k theta[k, dof] phi_k in SI units. docs/howto/plugins.md describes these files.
"""

import csv
import json
import os
import shlex
import shutil
import signal
import subprocess
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from math import isfinite, isinf, nan
from pathlib import Path
from reprlib import repr as short
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from seatrial.models.errors import ConfigurationError, PartError, SeatrialError
from seatrial.models.identification.problem import Identified, Identifier, Problem
from seatrial.models.ranges import Positive, check_ranges
from seatrial.models.vessel import basis
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag
from seatrial.runner.trials.closed_loop import training_series

RECORDING, ANSWER = "recording.csv", "coefficients.csv"
COLUMNS = ("term", "dof", "value", "std_error")


@dataclass(frozen=True)
class CommandIdentifier(Identifier):
    """Runs a command in the working folder, with the folder of the problem as its last argument.

    `limit_s` [s] is the longest time that it may take; the coefficients depend on `files` as well.
    """

    command: tuple[str, ...] = ()
    limit_s: Positive = 600.0
    files: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_ranges(self)

    def check(self, nominal: Vessel, thruster: SecondOrderLag | None, measured: bool) -> None:
        """Raise ConfigurationError for a command that is not installed, and for missing files."""
        if not self.command or shutil.which(self.command[0]) is None:
            got = repr(self.command[0]) if self.command else "none"
            expected = "a program that is installed, such as [python, fit.py]"
            raise ConfigurationError(f"identifier.command: got {got}, expected {expected}")
        for name in self.files:
            if not Path(name).is_file():
                raise ConfigurationError(f"identifier.files: got {name!r}, expected a file")

    def identify(self, problem: Problem, rng: np.random.Generator) -> Identified:
        """Return the nominal model with the coefficients of the program; raises PartError."""
        with TemporaryDirectory(prefix="seatrial-", ignore_cleanup_errors=True) as name:
            folder = Path(name)
            write_problem(folder, problem, int(rng.integers(2**31)))
            try:
                self._run(folder)
                if not (folder / ANSWER).is_file():
                    raise PartError(f"got no {ANSWER}, expected one")
                text = (folder / ANSWER).read_text(encoding="utf-8-sig", errors="replace")
                return identified(csv.DictReader(text.splitlines()), problem.nominal)
            except (PartError, OSError, csv.Error) as error:
                raise PartError(f"{shlex.join(self.command)}: {error}") from error

    def _run(self, folder: Path) -> None:
        """Run the command until it ends, or the limit; nothing that it started remains."""
        messages = folder / "messages.txt"
        with messages.open("wb") as output:
            process = subprocess.Popen(
                [*self.command, str(folder)], stdin=subprocess.DEVNULL, stdout=output,
                stderr=output, start_new_session=True,
            )  # fmt: skip
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


def write_problem(folder: Path, problem: Problem, seed: int) -> None:
    """Write the recording and the prior knowledge of the vessel to a folder."""
    series, nominal = training_series(problem.training), problem.nominal
    columns, header = np.column_stack([*series.columns.values()]), ",".join(series.columns)
    np.savetxt(folder / RECORDING, columns, "%.17g", ",", header=header, comments="")
    content = {
        "version": 1,  # of these files
        "vessel": nominal.name,
        "dofs": nominal.dofs,
        "sample_time_s": problem.training.period_s,
        "seed": seed,
        "recording": RECORDING,
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


def identified(rows: Iterable[Mapping[str, Any]], nominal: Vessel) -> Identified:
    """Return the nominal model with the coefficients of the rows; others keep their values.

    Each row has term, dof, value and maybe std_error. Raises PartError for one that has not.
    """
    found: dict[tuple[basis.Term, int], tuple[float, float]] = {}
    for number, row in enumerate(rows, 1):
        where = f"{ANSWER}: coefficient {number}: "
        try:
            term, dof = basis.term(row["term"]), nominal.dofs.index(row["dof"])
            value, spread = float(row["value"]), float(row.get("std_error") or nan)
            if not set(row) <= set(COLUMNS) or not isfinite(value) or isinf(spread):
                raise ValueError
        except SeatrialError as error:
            raise PartError(f"{where}{error}") from error
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            expected = f"term, dof ({', '.join(nominal.dofs)}), finite value, maybe std_error"
            raise PartError(f"{where}got {short(dict(row))}, expected {expected}") from error
        if (term, dof) in found:
            raise PartError(f"{where}got {term.name} in {nominal.dofs[dof]} twice")
        found[term, dof] = value, spread
    if not found:
        raise PartError(f"{ANSWER}: got no coefficients, expected at least one")
    terms = tuple(dict.fromkeys([*nominal.terms, *(term for term, _ in found)]))
    theta = np.array(nominal.on(terms).theta)
    errors = np.full(theta.shape, nan)
    for (term, dof), estimate in found.items():
        theta[terms.index(term), dof], errors[terms.index(term), dof] = estimate
    model = Vessel(nominal.name, nominal.dofs, terms, theta, nominal.attitude)
    return Identified(model, model - nominal, std_error=errors)
