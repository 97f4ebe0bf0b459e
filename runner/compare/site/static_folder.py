"""Writes the site to a folder, which opens from disk and from any web server."""

from collections.abc import Iterator
from contextlib import suppress
from importlib import resources
from pathlib import Path

from seatrial.models.errors import LogbookError
from seatrial.runner.compare.frame import Queries
from seatrial.runner.compare.site import contents
from seatrial.runner.compare.site.measures import StoredMeasures
from seatrial.runner.compare.site.scripts import (
    FAILURES,
    PROGRESS,
    SUMMARY,
    coefficient_script,
    metric_script,
    run_script,
    script_of,
    tables_script,
)

INDEX = "index.html"
MARK = '<meta name="generator" content="seatrial-results site">'


def assets() -> dict[str, bytes]:
    """Return the files of the page that hold no results, by name."""
    folder = resources.files(__package__).joinpath("assets")
    return {item.name: item.read_bytes() for item in folder.iterdir() if item.is_file()}


def write_site(results: Queries, folder: Path, database: str, opened: int) -> Path:
    """Write the site and return its first page.

    `folder` is new, empty, or holds a site; `database` is the address as the user wrote it;
    the newest `opened` runs are written whole, with
    their series. Raises LogbookError if it cannot be written.
    """
    try:
        _require_own(folder)
        (folder / "data").mkdir(parents=True, exist_ok=True)
        for old in (folder / "data").glob("*.js"):
            old.unlink()
        for name, content in assets().items():
            place = folder / name if name == INDEX else folder / "assets" / name
            place.parent.mkdir(exist_ok=True)
            place.write_bytes(content)
        for name, told in _scripts(results, database, opened):
            (folder / name).write_text(script_of(name, told), encoding="ascii")
    except OSError as error:
        raise LogbookError(f"{folder}: cannot write the site: {error.strerror}") from error
    except (UnicodeEncodeError, ValueError) as error:
        raise LogbookError(f"{folder}: cannot write the site: expected a name in UTF-8") from error
    return folder / INDEX


def _require_own(folder: Path) -> None:
    """Refuse a folder with files of others."""
    index = folder / INDEX
    with suppress(FileNotFoundError):
        if index.is_file() and MARK in index.read_text(encoding="utf-8", errors="replace"):
            return
        if any(folder.iterdir()):
            raise LogbookError(f"{folder}: got a folder with files, expected a new or empty one")


def _scripts(results: Queries, database: str, opened: int) -> Iterator[tuple[str, object]]:
    """Yield the name and the content of every script."""
    told = contents.summary(results, database, StoredMeasures(), opened)
    yield SUMMARY, told
    yield PROGRESS, contents.progress(results)
    yield FAILURES, contents.failures(results)
    if told["runs"]:
        for sweep in (None, *contents.tabled(results)):
            yield tables_script(sweep), contents.tables(results, sweep)
    for name in results.metric_names():
        yield metric_script(name), contents.metric(results, name)
    for term in results.terms():
        yield coefficient_script(term), contents.coefficient(results, term)
    for run in contents.all_runs(results)[::-1][:opened]:
        yield run_script(run.id), contents.one_run(results, run.id)
