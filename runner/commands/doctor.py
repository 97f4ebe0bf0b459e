"""`seatrial doctor`: whether this machine has what seatrial needs, and what it could have.

Every line is one of: ok; problem, which makes the exit code 1; absent, for what is optional.
"""

import os
import platform
import re
import tempfile
import tomllib
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
    PROJECT,
    ROOT,
    in_checkout,
    program_version,
    trial_program,
)
from seatrial.runner.database.engine import ENVIRONMENT

OF_PROJECT = ("test", "bench", "check", "docs")  # extras for work on the project itself


class Check(NamedTuple):
    """One line: `verdict` is ok, problem or absent; `note` is what was expected or is lost."""

    verdict: str
    name: str
    result: str
    note: str = ""


def main(arguments: Sequence[str]) -> int:
    """Print the checks and return 1 if there is a problem, else 0."""
    if arguments:
        raise ConfigurationError(f"doctor: got {' '.join(arguments)}, expected no arguments")
    checks = list(examined())
    for check in checks:
        note = f"  ({check.note})" if check.note else ""
        print(f"{check.verdict:<8} {check.name:<22} {check.result}{note}")
    problems = sum(check.verdict == "problem" for check in checks)
    print(f"{problems} problem{'' if problems == 1 else 's'}")
    return 1 if problems else 0


def examined() -> Iterator[Check]:
    """Check interpreter, packages, extras, cache, data and logbook, in this order."""
    if in_checkout():
        project = tomllib.loads(PROJECT.read_text(encoding="utf-8"))["project"]
        supported, lines = project["requires-python"], list(project["dependencies"])
        for extra, own in project["optional-dependencies"].items():
            lines += [f'{line}; extra == "{extra}"' for line in own]
    else:
        supported, lines = metadata("seatrial")["Requires-Python"], requires("seatrial") or []
    extras = sorted(set(re.findall(r"extra == [\"'](\w+)", "\n".join(lines))) - {*OF_PROJECT})
    of_extra: dict[str, list[Check]] = {extra: [] for extra in extras}
    yield _check("seatrial", program_version(), note=str(ROOT))
    yield _version("Python", platform.python_version(), SpecifierSet(supported))
    for requirement in map(Requirement, lines):
        marker = requirement.marker
        if marker is None or marker.evaluate({"extra": ""}):
            yield _package(requirement)
            continue
        for extra in extras:
            if marker.evaluate({"extra": extra}):
                of_extra[extra].append(_package(requirement))
    for extra, checks in of_extra.items():
        found = ", ".join(f"{check.name} {check.result}" for check in checks)
        wrong = [check for check in checks if check.verdict == "problem"]
        if any(check.result == "not installed" for check in wrong):
            yield Check("absent", f"extra {extra}", found, f"pip install 'seatrial[{extra}]'")
        else:
            yield _check(f"extra {extra}", found, wrong[0].note if wrong else "")
    yield _cache()
    if data := os.environ.get("SEATRIAL_DATA"):
        yield _check("SEATRIAL_DATA", data, "" if Path(data).is_dir() else "not a folder")
    else:
        yield Check("absent", "SEATRIAL_DATA", "not set", "for experiments on outside data")
    yield _logbook(ENVIRONMENT if os.environ.get(ENVIRONMENT) else DEFAULT_DATABASE)


def _check(name: str, result: str, problem: str = "", note: str = "") -> Check:
    return Check("problem" if problem else "ok", name, result, problem or note)


def _package(requirement: Requirement) -> Check:
    try:
        return _version(requirement.name, version(requirement.name), requirement.specifier)
    except PackageNotFoundError:
        return _check(requirement.name, "not installed", f"expected {requirement}")


def _version(name: str, result: str, versions: SpecifierSet) -> Check:
    fits = versions.contains(result, prereleases=True)
    return _check(name, result, "" if fits else f"expected {versions}")


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
    if folder.is_relative_to(tempfile.gettempdir()) and not wanted:
        note = "temporary: set SEATRIAL_CACHE to a folder that stays"
    return _check("compiled code", str(folder), problem, note)


def _logbook(url: str) -> Check:
    """Check that the logbook can be read; a SQLite file is made by the first trial."""
    shown = url
    try:
        shown = database.engine.display_url(url)
        address = database.engine.parse(url)
        if address.path is not None and not address.path.exists():
            return _check("logbook", shown, note=f"made by the first trial of {trial_program()}")
        condition = database.schema.inspect(address)
    except SeatrialError as error:
        return _check("logbook", shown, str(error))
    return _check("logbook", shown, note=f"schema: {condition.value}")
