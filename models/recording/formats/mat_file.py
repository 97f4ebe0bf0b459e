"""MATLAB files: v5 by scipy, 7.3 (HDF5) by h5py; vectors, matrices and structs of them."""

import zlib
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import scipy
from numpy.typing import NDArray

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.recording.formats.bounded import bounded
from seatrial.models.recording.formats.nested import sources_of_arrays
from seatrial.models.recording.source import LARGEST_BYTES, ReadOptions, Source

EXPECTED = "a MATLAB file"
HDF5 = b"\x89HDF\r\n\x1a\n"
COMPRESSED = 15  # type of an element of a v5 file
DEEPEST = 8  # structs in structs
PIECE = 2**20


def read(path: Path, options: ReadOptions) -> list[Source]:
    """The variables of a MATLAB file; raises RecordingError if it cannot be read."""
    with path.open("rb") as file:
        head = file.read(1024)
    if HDF5 in (head[:8], head[512:520]):
        if find_spec("h5py") is None:
            raise ConfigurationError(
                f"{path}: is a MATLAB 7.3 file: h5py is not installed: pip install 'seatrial[mat]'"
            )
        with bounded(path, EXPECTED):
            arrays = _datasets(path)
    else:
        _check_uncompressed(path)
        with bounded(path, EXPECTED):
            variables = scipy.io.loadmat(path, struct_as_record=False, squeeze_me=True)
            arrays = {}
            for name, value in variables.items():
                if not name.startswith("__"):
                    arrays |= _fields(name, value, 0)
    sources = sources_of_arrays(path, arrays)
    if not sources:
        raise RecordingError(
            f"{path}: got no vector of numbers, expected vectors, matrices or structs of them"
        )
    return sources


def _fields(name: str, value: object, depth: int) -> dict[str, NDArray[np.generic]]:
    """The arrays of a variable, which may be a struct, by dotted name."""
    if isinstance(value, np.ndarray) and value.dtype.kind in "biuf":
        return {name: value}
    arrays: dict[str, NDArray[np.generic]] = {}
    if depth < DEEPEST:
        for field in getattr(value, "_fieldnames", ()):
            arrays |= _fields(f"{name}.{field}", getattr(value, field), depth + 1)
    return arrays


def _check_uncompressed(path: Path) -> None:
    """Raise RecordingError if the compressed elements of a v5 file hold too much."""
    total, size = 0, path.stat().st_size
    with path.open("rb") as file:
        head = file.read(128)
        order = "little" if head[126:128] == b"IM" else "big"
        while len(tag := file.read(8)) == 8:
            kind = int.from_bytes(tag[:4], order)  # type: ignore[arg-type]
            length = int.from_bytes(tag[4:], order)  # type: ignore[arg-type]
            end = min(file.tell() + length, size)
            unpacker = zlib.decompressobj()
            while kind == COMPRESSED and file.tell() < end and total <= LARGEST_BYTES:
                total += _unpacked(unpacker, file.read(min(PIECE, end - file.tell())))
            if total > LARGEST_BYTES:
                raise RecordingError(
                    f"{path}: got more than {LARGEST_BYTES / 1e6:.0f} MB of numbers when "
                    "decompressed, expected at most as many; cut the recording"
                )
            file.seek(end)


def _unpacked(unpacker: "zlib._Decompress", piece: bytes) -> int:
    """How many bytes a compressed piece holds; counting ends at the largest number allowed."""
    total = 0
    try:
        while piece and total <= LARGEST_BYTES:
            total += len(unpacker.decompress(piece, PIECE))
            piece = unpacker.unconsumed_tail
    except zlib.error:  # the reader proper says it
        return total
    return total


def _datasets(path: Path) -> dict[str, NDArray[np.generic]]:
    """The datasets of numbers, by dotted name; text and MATLAB's own references are left out.

    Raises RecordingError if they are too large.
    """
    import h5py

    found: dict[str, h5py.Dataset] = {}

    def visit(name: str, item: object) -> None:
        hidden = name.startswith("#") or getattr(item, "attrs", {}).get("MATLAB_class") == b"char"
        if isinstance(item, h5py.Dataset) and item.dtype.kind in "biuf" and not hidden:
            found[name.replace("/", ".")] = item

    with h5py.File(path, "r") as stored:
        stored.visititems(visit)
        size = sum(item.size * max(item.dtype.itemsize, 8) for item in found.values())
        if size > LARGEST_BYTES:
            raise RecordingError(
                f"{path}: got {size / 1e6:.3g} MB of numbers, expected at most "
                f"{LARGEST_BYTES / 1e6:.0f}; cut the recording"
            )
        return {name: item[()] for name, item in found.items() if item.ndim}
