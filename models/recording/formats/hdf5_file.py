"""HDF5, which MATLAB 7.3 writes, by the package h5py."""

from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from seatrial.models.errors import RecordingError
from seatrial.models.recording.source import LARGEST_BYTES


def datasets(path: Path) -> dict[str, NDArray[np.generic]]:
    """The datasets of numbers, by dotted name; text and MATLAB's own references are left out.

    Raises RecordingError if they are too large.
    """
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
