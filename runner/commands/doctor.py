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
    yield Check("ok", "seatrial", program_version(), str(ROOT))
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
        verdict, note = ("problem", wrong[0].note) if wrong else ("ok", "")
        if any(check.result == "not installed" for check in wrong):
            verdict, note = "absent", f"pip install 'seatrial[{extra}]'"
        yield Check(verdict, f"extra {extra}", found, note)
    yield _cache()
    data = os.environ.get("SEATRIAL_DATA")
    if not data:
        yield Check("absent", "SEATRIAL_DATA", "not set", "for experiments on outside data")
    elif Path(data).is_dir():
        yield Check("ok", "SEATRIAL_DATA", data)
    else:
        yield Check("problem", "SEATRIAL_DATA", data, "not a folder")
    yield _logbook(ENVIRONMENT if os.environ.get(ENVIRONMENT) else DEFAULT_DATABASE)


def _package(requirement: Requirement) -> Check:
    try:
        return _version(requirement.name, version(requirement.name), requirement.specifier)
    except PackageNotFoundError:
        return Check("problem", requirement.name, "not installed", f"expected {requirement}")


def _version(name: str, result: str, versions: SpecifierSet) -> Check:
    if versions.contains(result, prereleases=True):
        return Check("ok", name, result)
    return Check("problem", name, result, f"expected {versions}")


def _cache() -> Check:
    """Check that machine code can be kept: every process would compile again otherwise."""
    folder, wanted = cache_home(), os.environ.get("SEATRIAL_CACHE")
    if wanted and folder != Path(wanted):
        return Check("problem", "compiled code", str(folder), f"{wanted} cannot be written")
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        return Check("problem", "compiled code", str(folder), f"not writable: {error.strerror}")
    if folder.is_relative_to(tempfile.gettempdir()) and not wanted:
        note = "temporary: set SEATRIAL_CACHE to a folder that stays"
    else:
        sizes = [path.stat().st_size for path in folder.rglob("*") if path.is_file()]
        note = f"{sum(sizes) / 1e6:.0f} MB in {len(sizes)} files; it may be deleted"
    return Check("ok", "compiled code", str(folder), note)


def _logbook(url: str) -> Check:
    """Check that the logbook can be read; a SQLite file is made by the first trial."""
    shown = url
    try:
        shown = database.engine.display_url(url)
        address = database.engine.parse(url)
        if address.path is not None and not address.path.exists():
            return Check("ok", "logbook", shown, f"made by the first trial of {trial_program()}")
        condition = database.schema.inspect(address)
    except SeatrialError as error:
        return Check("problem", "logbook", shown, str(error))
    return Check("ok", "logbook", shown, f"schema: {condition.value}")
