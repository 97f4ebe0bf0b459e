"""MATLAB files: v5 by scipy, 7.3 (HDF5) by h5py; vectors, matrices, structs and cells of them."""

import zlib
from collections import Counter, defaultdict
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from textwrap import shorten
from typing import Any

import numpy as np
import scipy

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.recording.source import (
    LARGEST_BYTES,
    MOST_ELEMENTS,
    ReadOptions,
    Source,
    TextArray,
    check_size,
    foreign,
)
from seatrial.models.vessel.basis import Array

EXPECTED = "a MATLAB file"
HDF5 = b"\x89HDF\r\n\x1a\n"
COMPRESSED = 15  # type of an element of a v5 file
DEEPEST = 8  # structs in structs
PIECE = 2**20
NUMERIC = ("double", "single", "logical", "cell", "struct", "char")  # and int8 ... uint64


def read(path: Path, options: ReadOptions) -> list[Source]:
    """The variables of a MATLAB file; raises RecordingError if it cannot be read."""
    with path.open("rb") as file:
        head = file.read(1024)
    if HDF5 in (head[:8], head[512:520]):
        if find_spec("h5py") is None:
            raise ConfigurationError(
                f"{path}: is a MATLAB 7.3 file: h5py is not installed: pip install 'seatrial[mat]'"
            )
        with foreign(path, EXPECTED):
            variables = _of_hdf5(path)
    else:
        _check_uncompressed(path)
        with foreign(path, EXPECTED):
            stored = scipy.io.loadmat(path, struct_as_record=False, squeeze_me=True)
            variables = {}
            for name, value in stored.items():
                if isinstance(value, scipy.io.matlab.MatlabOpaque):  # its own name is lost
                    name, value = value["s0"].item().decode(), _of_scipy(value)
                if not name.startswith("__"):
                    variables[name] = _of_scipy(value)
    leaves = [leaf for name, value in variables.items() for leaf in _leaves("", name, value, 0)]
    return sources_of_arrays(path, leaves, {}, EXPECTED)


def sources_of_arrays(
    path: Path, leaves: list[tuple[str, str, object]], units: dict[str, str], expected: str
) -> list[Source]:
    """Vectors and matrices with a row or column a sample, by source and name, as sources.

    Those of equal length share a clock: the variables of a file, and the fields of one struct.
    Columns of a matrix are named `name[0]`, `name[1]` ...; what is neither is named as left out.
    """
    groups: dict[tuple[str, int], dict[str, Array | TextArray]] = defaultdict(dict)
    known: dict[tuple[str, int], dict[str, str]] = defaultdict(dict)
    lost: dict[str, list[str]] = defaultdict(list)
    check_size(path, sum(value.size for *_, value in leaves if isinstance(value, np.ndarray)))
    for top, name, value in leaves:
        full = f"{top}.{name}" if top else name
        if not isinstance(value, np.ndarray):
            lost[str(value)].append(full)
            continue
        values = np.squeeze(value if value.dtype == np.object_ else value.astype(np.float64))
        if values.ndim == 1 and len(values) > 1:
            columns = {name: values}
        elif values.ndim == 2 and min(values.shape) <= MOST_ELEMENTS and values.dtype != np.object_:
            rows = values.T if values.shape[0] > values.shape[1] else values
            columns = {f"{name}[{i}]": row for i, row in enumerate(rows)}
        else:
            shape = " x ".join(map(str, values.shape))
            lost["single values" if values.size <= 1 else f"arrays of {shape}"].append(full)
            continue
        place = (top, len(next(iter(columns.values()))))
        groups[place] |= columns
        known[place] |= {column: units[name] for column in columns if name in units}
    left_out = tuple(
        f"{shorten(', '.join(names), 200, placeholder=' ...')}: {kind}, no columns"
        for kind, names in lost.items()
    )
    if not groups:
        raise RecordingError(
            f"{path}: got no vector of numbers{''.join(f'; {line}' for line in left_out)}, "
            f"expected {expected} with vectors, matrices or structs of them"
        )
    lengths = Counter(top for top, _ in groups)
    sources: list[Source] = []
    for place, columns in sorted(groups.items(), key=lambda item: -len(item[1])):
        base = place[0] or path.stem
        first = all(source.name != base for source in sources)
        name = base if lengths[place[0]] == 1 or first else f"{base}/{place[1]}"
        said = left_out if not sources else ()
        sources.append(Source(name, path, columns, known[place], left_out=said))
    return sources


def _leaves(top: str, name: str, value: object, depth: int) -> Iterator[tuple[str, str, object]]:
    """The arrays of a variable by source and name: a struct and each cell is a source.

    Cells or structs of single numbers are the rows of one source.
    """
    if depth > DEEPEST:
        yield top, name, "too deep in structs"
    elif isinstance(value, dict):
        for field, inner in value.items():
            own = (top, f"{name}.{field}") if top and name else (top or name, field)
            yield from _leaves(*own, inner, depth + 1)
    elif isinstance(value, list):
        base = "/".join(part for part in (top, *name.split(".")) if part)
        rows = [list(_leaves("", "", element, depth + 1)) for element in value]
        single = [{n: v.item() for _, n, v in row if isinstance(v, np.ndarray) and v.size == 1} for row in rows]
        if len(rows) > 1 and all(len(own) == len(row) for own, row in zip(single, rows, strict=True)):
            for field in dict.fromkeys(key for own in single for key in own):
                yield base, field or base, np.array([own.get(field, np.nan) for own in single])
            return
        for number, element in enumerate(value, 1):
            own = "" if isinstance(element, dict | list) else base.rpartition("/")[2]
            yield from _leaves(f"{base}/{number}", own, element, depth + 1)
    else:
        yield top, name, value


def _of_scipy(value: Any) -> object:
    """A variable as dictionaries, lists and arrays; what it is instead where it is none."""
    if isinstance(value, scipy.io.matlab.MatlabOpaque):
        return f"objects of class {value['s2'].item().decode()}"
    if isinstance(value, scipy.io.matlab.mat_struct):
        return {field: _of_scipy(getattr(value, field)) for field in value._fieldnames}
    if isinstance(value, str) or (isinstance(value, np.ndarray) and value.dtype.kind in "US"):
        return "text"
    array = np.asarray(value)
    if array.dtype.kind in "biuf":
        return array
    if array.dtype == np.object_:
        return [_of_scipy(element) for element in array.ravel()]
    return f"{type(value).__name__} of {array.dtype.name}"


def _of_hdf5(path: Path) -> dict[str, object]:
    """The variables of a 7.3 file; raises RecordingError if they are too large."""
    import h5py

    size = 0

    def visit(name: str, item: object) -> None:
        nonlocal size
        size += item.size * max(item.dtype.itemsize, 8) if isinstance(item, h5py.Dataset) else 0

    def plain(item: Any, stored: Any) -> object:
        kind = item.attrs.get("MATLAB_class", b"double").decode()
        if "MATLAB_object_decode" in item.attrs or not (kind in NUMERIC or "int" in kind):
            return f"objects of class {kind}"
        if isinstance(item, h5py.Group):
            fields = {name: plain(inner, stored) for name, inner in item.items()}
            count = {len(v) if isinstance(v, list) and item[k].attrs.get("MATLAB_class") is None
                     else 0 for k, v in fields.items()}  # fmt: skip
            if len(count) == 1 and (number := count.pop()):  # an array of structs
                return [{k: v[i] for k, v in fields.items()} for i in range(number)]  # type: ignore[index]
            return fields
        if kind == "char":
            return "text"
        if item.dtype == h5py.ref_dtype:
            return [plain(stored[reference], stored) for reference in item[()].T.ravel()]
        if "MATLAB_empty" in item.attrs:
            return "empty arrays"
        return item[()] if item.dtype.kind in "biuf" else f"values of {item.dtype}"

    with h5py.File(path, "r") as stored:
        stored.visititems(visit)
        if size > LARGEST_BYTES:
            raise RecordingError(
                f"{path}: got {size / 1e6:.3g} MB of numbers, expected at most "
                f"{LARGEST_BYTES / 1e6:.0f}; cut the recording"
            )
        return {name: plain(item, stored) for name, item in stored.items() if name[0] != "#"}


def _check_uncompressed(path: Path) -> None:
    """Raise RecordingError if the compressed elements of a v5 file hold too much."""
    total, size = 0, path.stat().st_size
    with path.open("rb") as file:
        order = "<" if file.read(128)[126:] == b"IM" else ">"
        while len(tag := file.read(8)) == 8:
            kind, length = map(int, np.frombuffer(tag, f"{order}u4"))
            end = min(file.tell() + length, size)
            unpacker = zlib.decompressobj()
            try:
                while kind == COMPRESSED and file.tell() < end and total <= LARGEST_BYTES:
                    piece = file.read(min(PIECE, end - file.tell()))
                    while piece and total <= LARGEST_BYTES:
                        total += len(unpacker.decompress(piece, PIECE))
                        piece = unpacker.unconsumed_tail
            except zlib.error:  # the reader proper says it
                return
            if total > LARGEST_BYTES:
                raise RecordingError(
                    f"{path}: got more than {LARGEST_BYTES / 1e6:.0f} MB of numbers when "
                    "decompressed, expected at most as many; cut the recording"
                )
            file.seek(end)
