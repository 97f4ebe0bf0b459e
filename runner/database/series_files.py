"""Series files: the time series of a run as one Parquet file beside the database.

The column `kind` tells the series of a run apart; a column that a kind does not have is null there.
A file is written under a temporary name, flushed to the disk and renamed before any row refers to
it, so it is never incomplete. Its name holds the number of its run and a random mark, so no file
replaces one of another logbook. pyarrow is imported only when a file is written or read.
"""

import json
import os
import re
from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any
from uuid import uuid4

import numpy as np
from numpy.typing import NDArray

from seatrial.models.errors import LogbookError
from seatrial.runner.database.tables import SeriesRow
from seatrial.runner.record.rows import Series

if TYPE_CHECKING:
    import pyarrow as pa
else:
    import lazy_loader

    pa = lazy_loader.load("pyarrow")

FOLDER = "series"
_KIND = re.compile(r"[a-z][a-z0-9_]*")
# run-NUMBER-MARK.parquet; temporary: a dot before, .PID.tmp after
NAME = re.compile(r"\.?run-(?P<run>\d+)-[0-9a-f]{12}\.parquet(?:\.\d+\.tmp)?")


def write(results_dir: Path, run_id: int, series: Sequence[Series]) -> list[dict[str, object]]:
    """Write the series of run `run_id` to its file; returns their rows, if there are any.

    Raises LogbookError, and leaves no file, if the disk is full or the folder cannot be written.
    """
    if not series:
        return []
    content = parquet_of(series)
    relative = f"{FOLDER}/run-{run_id:06d}-{uuid4().hex[:12]}.parquet"
    path = results_dir / relative
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _write_atomically(path, content)
    except OSError as error:
        raise LogbookError(f"{path}: cannot be written: {error.strerror}") from error
    same = {"run_id": run_id, "path": relative, "sha256": sha256(content).hexdigest()}
    return [
        {"kind": item.kind, "n_rows": item.n_rows, "columns": dict(item.units), **same}
        for item in series
    ]


def parquet_of(series: Sequence[Series]) -> memoryview:
    """Return the content of a Parquet file with the columns of all series, and their units.

    LZ4 of separated bytes takes less time than zstd, and less space.
    """
    from pyarrow import parquet

    if wrong := [item.kind for item in series if not _KIND.fullmatch(item.kind)]:
        raise ValueError(f"kind of series: got {wrong[0]!r}, expected a name like recording")
    names = list(dict.fromkeys(name for item in series for name in item.columns))
    absent = [pa.nulls(item.n_rows, pa.float64()) for item in series]
    columns = {"kind": pa.chunked_array([_repeated(s.kind, s.n_rows) for s in series], pa.string())}
    for name in names:
        pairs = zip(series, absent, strict=True)
        own = [_array(s.columns[name]) if name in s.columns else none for s, none in pairs]
        columns[name] = pa.chunked_array(own, pa.float64())
    units = json.dumps({item.kind: dict(item.units) for item in series})
    table = pa.table(columns).replace_schema_metadata({"units": units})
    sink = pa.BufferOutputStream()
    parquet.write_table(
        table, sink, compression="lz4", use_dictionary=["kind"], write_statistics=["kind"],
        use_byte_stream_split=names, write_batch_size=max(len(table), 1),
    )  # fmt: skip
    return memoryview(sink.getvalue())


def _array(column: NDArray[Any]) -> "pa.Array":
    """Convert a column to pyarrow without a copy; `pyarrow.array` would import pandas."""
    values = np.ascontiguousarray(column, dtype=np.float64)
    return pa.Array.from_buffers(pa.float64(), len(values), [None, pa.py_buffer(values)])


def _repeated(text: str, n: int) -> "pa.Array":
    """Return `n` times an ASCII text; `pyarrow.repeat` would import pandas."""
    ends = len(text) * np.arange(n + 1, dtype=np.int32)
    buffers = [None, pa.py_buffer(ends), pa.py_buffer(n * text.encode())]
    return pa.Array.from_buffers(pa.string(), n, buffers)


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


def read(results_dir: Path, file: SeriesRow) -> Series:
    """Read a series; raises LogbookError if the file is missing or was changed."""
    from pyarrow import parquet

    content, names = pa.BufferReader(checked(results_dir, file)), [*file.columns]
    own = [("kind", "==", file.kind)]
    try:
        table = parquet.read_table(content, columns=names, filters=own, use_threads=False)
        columns = {name: table.column(name).to_numpy() for name in names}
    except (pa.ArrowException, KeyError) as error:
        raise LogbookError(f"{file.path}: cannot be read: {error}") from error
    return Series(file.kind, columns, dict(file.columns))


def checked(results_dir: Path, file: SeriesRow) -> bytes:
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
