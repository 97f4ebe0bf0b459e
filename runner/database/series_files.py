"""Series files: time series as Parquet files beside the database.

A file is written under a temporary name, flushed to the disk and renamed before any row refers to
it, so it is never incomplete. Its name holds the number of its run and a mark that is unique over
all logbooks, so no file replaces another. pyarrow is imported only when a file is written or read.
"""

import os
import re
from collections.abc import Sequence
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from seatrial.models.errors import LogbookError
from seatrial.runner.database.records import SeriesFile
from seatrial.runner.record.rows import Series

if TYPE_CHECKING:
    import pyarrow as pa
else:
    import lazy_loader

    pa = lazy_loader.load("pyarrow")

FOLDER = "series"
FORMAT = "parquet"
_KIND = re.compile(r"[a-z][a-z0-9_]*")
# run-NUMBER-KIND-MARK.parquet (no mark in older versions); temporary: a dot before, .PID.tmp after
_NAME = re.compile(
    r"\.?run-(?P<run>\d+)-[a-z][a-z0-9_]*(?:-(?P<mark>[0-9a-f]{12}))?\.parquet(?:\.\d+\.tmp)?"
)


def mark(fingerprint: str, attempt: int, started_at: datetime) -> str:
    """Return the mark of a run's files, which is unique over all runs and logbooks."""
    run = f"{fingerprint} {attempt} {started_at.astimezone(UTC).isoformat()}"
    return sha256(run.encode()).hexdigest()[:12]


def owner(path: Path) -> tuple[int, str | None] | None:
    """Return the run number and mark in the name of a file; None for any other file."""
    match = _NAME.fullmatch(path.name)
    return (int(match["run"]), match["mark"]) if match else None


def listed(results_dir: Path) -> list[Path]:
    """List every file in the folder of series, including temporary files."""
    folder = results_dir / FOLDER
    try:
        if not folder.is_dir():
            return []
        return sorted(path for path in folder.iterdir() if path.is_file())
    except OSError as error:
        raise LogbookError(f"{folder}: cannot be read: {error.strerror}") from error


def write(
    results_dir: Path, run_id: int, run_mark: str, series: Sequence[Series]
) -> list[SeriesFile]:
    """Write each series to a file of run `run_id`; on an error none of the files remains.

    Raises LogbookError if the disk is full or the folder cannot be written.
    """
    written: list[SeriesFile] = []
    try:
        for item in series:
            written.append(_write_series(results_dir, f"run-{run_id:06d}", run_mark, item))
    except BaseException:
        discard(results_dir, written)
        raise
    return written


def _write_series(results_dir: Path, run: str, run_mark: str, series: Series) -> SeriesFile:
    if not _KIND.fullmatch(series.kind):
        raise ValueError(f"kind of series: got {series.kind!r}, expected a name like recording")
    content = parquet_of(series)
    relative = f"{FOLDER}/{run}-{series.kind}-{run_mark}.{FORMAT}"
    path = results_dir / relative
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _write_atomically(path, content)
    except OSError as error:
        raise LogbookError(f"{path}: cannot be written: {error.strerror}") from error
    return SeriesFile(
        kind=series.kind,
        path=relative,
        format=FORMAT,
        n_rows=len(next(iter(series.columns.values()), ())),
        sha256=sha256(content).hexdigest(),
        columns=dict(series.units),
    )


def _array(column: NDArray[np.generic]) -> "pa.Array":
    """Convert a column to pyarrow, without a copy if it holds floats.

    `pyarrow.array` is avoided for floats because it imports pandas.
    """
    if column.dtype != np.float64:
        return pa.array(column)
    return pa.Array.from_buffers(
        pa.float64(), len(column), [None, pa.py_buffer(np.ascontiguousarray(column))]
    )


def parquet_of(series: Series) -> memoryview:
    """Return the content of a Parquet file with the columns of a series, and their units."""
    from pyarrow import parquet

    arrays = [_array(column) for column in series.columns.values()]
    fields = [
        pa.field(name, array.type, metadata={"unit": series.units[name]})
        for name, array in zip(series.columns, arrays, strict=True)
    ]
    schema = pa.schema(fields, metadata={"kind": series.kind})
    sink = pa.BufferOutputStream()
    parquet.write_table(pa.Table.from_arrays(arrays, schema=schema), sink, compression="zstd")
    return memoryview(sink.getvalue())


def _write_atomically(path: Path, content: memoryview) -> None:
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with temporary.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    _flush_folder(path.parent)


def _flush_folder(folder: Path) -> None:
    """Make the new name survive a power failure, if the system can (Windows cannot)."""
    try:
        handle = os.open(folder, os.O_RDONLY)
    except OSError:
        return
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def discard(results_dir: Path, files: Sequence[SeriesFile]) -> None:
    """Remove files that no row refers to, as far as possible."""
    for file in files:
        try:
            locate(results_dir, file.path).unlink(missing_ok=True)
        except (OSError, LogbookError):
            continue  # `verify` lists a file that remains


def locate(results_dir: Path, relative: str) -> Path:
    """Return the file at `relative`, a path from the database.

    Raises LogbookError if the path is outside the folder of series.
    """
    folder = (results_dir / FOLDER).resolve()
    path = (results_dir / relative).resolve() if "\x00" not in relative else folder
    if not path.is_relative_to(folder) or path == folder:
        raise LogbookError(f"series path {relative!r}: expected a file within {folder}")
    return path


def read(results_dir: Path, file: SeriesFile) -> Series:
    """Read a series; raises LogbookError if the file is missing or was changed."""
    from pyarrow import parquet

    content = checked(results_dir, file)
    try:
        table = parquet.read_table(pa.BufferReader(content))
        columns = {name: table.column(name).to_numpy() for name in table.column_names}
    except pa.ArrowException as error:
        raise LogbookError(f"{file.path}: not a Parquet file: {error}") from error
    return Series(file.kind, columns, dict(file.columns))


def shape(content: bytes) -> tuple[int, list[str]]:
    """Return the number of rows and the column names of a file.

    Raises LogbookError if it is not a Parquet file.
    """
    from pyarrow import parquet

    try:
        metadata = parquet.read_metadata(pa.BufferReader(content))
    except pa.ArrowException as error:
        raise LogbookError(f"not a Parquet file: {error}") from error
    return metadata.num_rows, list(metadata.schema.names)


def checked(results_dir: Path, file: SeriesFile) -> bytes:
    """Read a file and check its checksum; raises LogbookError if it differs."""
    path = locate(results_dir, file.path)
    try:
        content = path.read_bytes()
    except OSError as error:
        raise LogbookError(f"{path}: cannot be read: {error.strerror}") from error
    digest = sha256(content).hexdigest()
    if digest != file.sha256:
        raise LogbookError(
            f"{path}: the file was changed: got SHA-256 {digest[:12]}, expected {file.sha256[:12]}"
        )
    return content
