"""Series files: the time series of a run as one Parquet file beside the database.

The column `kind` tells the series of a run apart; a column that a kind does not have is null there.
A file is written under a temporary name, flushed to the disk and renamed before any row refers to
it, so it is never incomplete. Its name holds the number of its run and a mark that is unique over
all logbooks, so no file replaces another. pyarrow is imported only when a file is written or read.
"""

import json
import os
import re
from collections.abc import Sequence
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
_KIND = re.compile(r"[a-z][a-z0-9_]*")
# run-NUMBER-MARK.parquet; temporary: a dot before, .PID.tmp after
_NAME = re.compile(r"\.?run-(?P<run>\d+)-[0-9a-f]{12}\.parquet(?:\.\d+\.tmp)?")


def mark(fingerprint: str, started_at: datetime) -> str:
    """Return the mark of a run's file, which is unique over all runs and logbooks."""
    run = f"{fingerprint} {started_at.astimezone(UTC).isoformat()}"
    return sha256(run.encode()).hexdigest()[:12]


def owner(path: Path) -> int | None:
    """Return the run number in the name of a file; None for any other file."""
    match = _NAME.fullmatch(path.name)
    return int(match["run"]) if match else None


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
    """Write the series of run `run_id` to its file; returns where each kind is.

    Raises LogbookError, and leaves no file, if the disk is full or the folder cannot be written.
    """
    content = parquet_of(series)
    relative = f"{FOLDER}/run-{run_id:06d}-{run_mark}.parquet"
    path = results_dir / relative
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _write_atomically(path, content)
    except OSError as error:
        raise LogbookError(f"{path}: cannot be written: {error.strerror}") from error
    digest = sha256(content).hexdigest()
    return [
        SeriesFile(item.kind, relative, item.n_rows, digest, dict(item.units)) for item in series
    ]


def _array(column: NDArray[Any]) -> "pa.Array":
    """Convert a column to pyarrow without a copy; `pyarrow.array` would import pandas."""
    values = np.ascontiguousarray(column, dtype=np.float64)
    return pa.Array.from_buffers(pa.float64(), len(values), [None, pa.py_buffer(values)])


def parquet_of(series: Sequence[Series]) -> memoryview:
    """Return the content of a Parquet file with the columns of all series, and their units.

    Each kind is a row group of its own, so that one is read without the others. LZ4 of separated
    bytes takes less time than zstd, and less space.
    """
    from pyarrow import parquet

    if wrong := [item.kind for item in series if not _KIND.fullmatch(item.kind)]:
        raise ValueError(f"kind of series: got {wrong[0]!r}, expected a name like recording")
    names = list(dict.fromkeys(name for item in series for name in item.columns))
    fields = [pa.field("kind", pa.string()), *(pa.field(name, pa.float64()) for name in names)]
    units = json.dumps({item.kind: dict(item.units) for item in series})
    schema = pa.schema(fields, metadata={"units": units})
    sink = pa.BufferOutputStream()
    with parquet.ParquetWriter(
        sink,
        schema,
        compression="lz4",
        use_dictionary=["kind"],
        write_statistics=["kind"],
        use_byte_stream_split=names,
    ) as writer:
        for item in series:
            n_rows = item.n_rows
            if not n_rows:  # a row group without rows would have no kind
                continue
            absent = pa.nulls(n_rows, pa.float64())
            own = {name: _array(column) for name, column in item.columns.items()}
            arrays = [pa.repeat(item.kind, n_rows), *(own.get(name, absent) for name in names)]
            writer.write_batch(pa.RecordBatch.from_arrays(arrays, schema=schema), n_rows)
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
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)  # the new name survives a power failure
    finally:
        os.close(folder)


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
        stored = parquet.ParquetFile(pa.BufferReader(content))
        parts = [stored.metadata.row_group(i) for i in range(stored.metadata.num_row_groups)]
        kinds = [part.column(0).statistics.min for part in parts]
        groups = [i for i, kind in enumerate(kinds) if kind == file.kind]
        table = stored.read_row_groups(groups, columns=[*file.columns], use_threads=False)
        columns = {name: table.column(name).to_numpy() for name in file.columns}
    except (pa.ArrowException, KeyError) as error:
        raise LogbookError(f"{file.path}: cannot be read: {error}") from error
    return Series(file.kind, columns, dict(file.columns))


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
