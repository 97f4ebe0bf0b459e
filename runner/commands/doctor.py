"""`seatrial doctor`: whether this machine has what seatrial needs, and what it could have.

Every line is one of: ok; problem, which makes the exit code 1; absent, for what is optional.
"""

import os
import platform
import shutil
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

# Extras of users; the others are for work on the project itself.
EXTRAS = {
    "ardupilot": "excitation=recording with logs of ArduPilot",
    "excel": "excitation=recording with Excel files",
    "fmu": "validation of what seatrial-results model --to fmu writes",
    "mat": "excitation=recording with files of MATLAB 7.3",
    "netcdf": "excitation=recording with netCDF files",
    "nmea": "excitation=recording with NMEA 0183",
    "postgresql": "database=postgresql",
    "ray": "hydra/launcher=ray",
    "ros": "excitation=recording with bags of ROS and MCAP",
    "search": "hydra/sweeper=optuna",
    "slurm": "hydra/launcher=submitit_slurm",
    "ulog": "excitation=recording with logs of PX4",
}
PROGRAMS = {
    "cc": "seatrial-results model --to fmu",
    "chromium": "tests of the report",
    "git": "the commit of a checkout, stored with every run",
    "octave": "identifiers and models in Octave",
    "sbatch": "hydra/launcher=submitit_slurm",
}


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
    """Check interpreter, packages, extras, cache, programs, data and logbook, in this order."""
    supported, needed = _declared()
    yield Check("ok", "seatrial", program_version(), str(ROOT))
    yield _version("Python", platform.python_version(), supported)
    yield from (_package(r) for r in needed if r.marker is None or r.marker.evaluate())
    yield from (_extra(name, needed) for name in EXTRAS)
    yield _cache()
    for name, use in PROGRAMS.items():
        path = shutil.which(name)
        yield Check("ok", name, path) if path else Check("absent", name, "not found", f"for {use}")
    if data := os.environ.get("SEATRIAL_DATA"):
        own = ("ok", "") if Path(data).is_dir() else ("problem", "not a folder")
        yield Check(own[0], "SEATRIAL_DATA", data, own[1])
    else:
        yield Check("absent", "SEATRIAL_DATA", "not set", "for experiments on outside data")
    yield _logbook(ENVIRONMENT if os.environ.get(ENVIRONMENT) else DEFAULT_DATABASE)


def _declared() -> tuple[SpecifierSet, list[Requirement]]:
    """Return the supported versions of Python, and the requirements with those of the extras."""
    if not in_checkout():
        lines = requires("seatrial") or []
        return SpecifierSet(metadata("seatrial")["Requires-Python"]), list(map(Requirement, lines))
    project = tomllib.loads(PROJECT.read_text(encoding="utf-8"))["project"]
    lines = list(project["dependencies"])
    for extra, own in project["optional-dependencies"].items():
        lines += [f'{line}; extra == "{extra}"' for line in own]
    return SpecifierSet(project["requires-python"]), list(map(Requirement, lines))


def _package(requirement: Requirement) -> Check:
    try:
        return _version(requirement.name, version(requirement.name), requirement.specifier)
    except PackageNotFoundError:
        return Check("problem", requirement.name, "not installed", f"expected {requirement}")


def _version(name: str, result: str, versions: SpecifierSet) -> Check:
    if versions.contains(result, prereleases=True):
        return Check("ok", name, result)
    return Check("problem", name, result, f"expected {versions}")


def _extra(name: str, needed: Sequence[Requirement]) -> Check:
    """Check an extra: absent if a package is not installed, a problem if a version is wrong."""
    own = [r for r in needed if r.marker and r.marker.evaluate({"extra": name})]
    own = [r for r in own if not (r.marker and r.marker.evaluate({"extra": ""}))]
    checks, title = [_package(requirement) for requirement in own], f"extra {name}"
    if lacking := [check.name for check in checks if check.result == "not installed"]:
        remedy = f"for {EXTRAS[name]}: pip install 'seatrial[{name}]'"
        return Check("absent", title, f"without {', '.join(lacking)}", remedy)
    for check in checks:
        if check.verdict == "problem":
            return Check("problem", title, f"{check.name} {check.result}", check.note)
    return Check("ok", title, ", ".join(f"{check.name} {check.result}" for check in checks))


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
