"""`seatrial doctor`: whether this machine has what seatrial needs, and what it could have.

Every line is one of: ok; problem, which makes the exit code 1; absent, for what is optional.
"""

import os
import platform
import tempfile
from collections.abc import Iterator, Sequence
from importlib.metadata import PackageNotFoundError, metadata, requires, version
from pathlib import Path
from typing import NamedTuple

from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

from seatrial.models.errors import ConfigurationError, SeatrialError
from seatrial.models.source_digest import cache_home
from seatrial.runner import database
from seatrial.runner.configuration.invocation import (
    DEFAULT_DATABASE,
    ROOT,
    program_version,
    trial_program,
)

OF_PROJECT = ("test", "bench", "check", "docs")  # extras for work on the project itself


class Check(NamedTuple):
    """One line; what is not there is a `problem`, or absent if it is `optional`."""

    name: str
    result: str
    note: str = ""
    problem: bool = False
    optional: bool = False

    def __str__(self) -> str:
        verdict = ("absent" if self.optional else "problem") if self.problem else "ok"
        return (
            f"{verdict:<8} {self.name:<22} {self.result}{f'  ({self.note})' if self.note else ''}"
        )


def main(arguments: Sequence[str]) -> int:
    """Print the checks and return 1 if there is a problem, else 0."""
    if arguments:
        raise ConfigurationError(f"doctor: got {' '.join(arguments)}, expected no arguments")
    problems = 0
    for check in (*_packages(), _cache(), _data(), _logbook()):
        print(check)
        problems += check.problem and not check.optional
    print(f"{problems} problem{'' if problems == 1 else 's'}")
    return 1 if problems else 0


def _packages() -> Iterator[Check]:
    """Check interpreter, packages and extras against what the installed seatrial declares."""
    own, every = metadata("seatrial"), [*map(Requirement, requires("seatrial") or ())]
    yield Check("seatrial", program_version(), str(ROOT))
    yield _version("Python", platform.python_version(), SpecifierSet(own["Requires-Python"]))
    needed = [one for one in every if not one.marker or one.marker.evaluate({"extra": ""})]
    yield from map(_package, needed)
    for extra in sorted({*(own.get_all("Provides-Extra") or ())} - {*OF_PROJECT}):
        more = [one for one in every if not one.marker or one.marker.evaluate({"extra": extra})]
        checks = [_package(one) for one in more if one not in needed]
        found = ", ".join(f"{check.name} {check.result}" for check in checks)
        lacking = any(check.problem for check in checks)
        remedy = f"pip install 'seatrial[{extra}]'" if lacking else ""
        yield Check(f"extra {extra}", found, remedy, lacking, optional=True)


def _package(requirement: Requirement) -> Check:
    try:
        return _version(requirement.name, version(requirement.name), requirement.specifier)
    except PackageNotFoundError:
        return Check(requirement.name, "not installed", f"expected {requirement}", problem=True)


def _version(name: str, result: str, versions: SpecifierSet) -> Check:
    fits = versions.contains(result, prereleases=True)
    return Check(name, result, "" if fits else f"expected {versions}", not fits)


def _cache() -> Check:
    """Check that machine code can be kept: every process would compile again otherwise."""
    folder, wanted = cache_home(), os.environ.get("SEATRIAL_CACHE")
    problem = f"{wanted} cannot be written" if wanted and folder != Path(wanted) else ""
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        problem = problem or f"not writable: {error.strerror}"
    sizes = [path.stat().st_size for path in folder.rglob("*") if path.is_file()]
    note = f"{sum(sizes) / 1e6:.0f} MB in {len(sizes)} files; it may be deleted"
    return Check("compiled code", str(folder), problem or note, bool(problem))


def _data() -> Check:
    folder = os.environ.get("SEATRIAL_DATA")
    if not folder:
        note = "for experiments on outside data"
        return Check("SEATRIAL_DATA", "not set", note, problem=True, optional=True)
    absent = not Path(folder).is_dir()
    return Check("SEATRIAL_DATA", folder, "not a folder" * absent, absent)


def _logbook() -> Check:
    """Check that the logbook can be read; a SQLite file is made by the first trial."""
    variable = database.engine.ENVIRONMENT
    shown = url = variable if os.environ.get(variable) else DEFAULT_DATABASE
    try:
        shown = database.engine.display_url(url)
        address = database.engine.parse(url)
        if address.path is not None and not address.path.exists():
            return Check("logbook", shown, f"made by the first trial of {trial_program()}")
        state = database.schema.inspect(address)
    except SeatrialError as error:
        return Check("logbook", shown, str(error), problem=True)
    return Check("logbook", shown, f"schema: {state.value}")
