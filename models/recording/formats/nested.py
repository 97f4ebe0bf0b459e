"""Arrays and messages with fields, as columns."""

from collections import Counter, defaultdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from seatrial.models.recording.source import Source, TextArray, check_size
from seatrial.models.vessel.basis import Array

MOST_ELEMENTS = 64  # of an array in a message or of a matrix; larger ones are images and the like


def sources_of_arrays(path: Path, arrays: dict[str, NDArray[np.generic]]) -> list[Source]:
    """Vectors and matrices with a row or column a sample, by name, as sources.

    Those of equal length share a clock: the variables of a file, and the fields of one struct.
    Columns of a matrix are named `name[0]`, `name[1]` ...; scalars and text are left out.
    """
    groups: dict[tuple[str, int], dict[str, Array | TextArray]] = defaultdict(dict)
    check_size(path, sum(array.size for array in arrays.values()))
    for name, array in arrays.items():
        top, _, field = name.partition(".")
        for suffix, values in _columns(array).items():
            place = (top if field else "", len(values))
            groups[place][f"{field or top}{suffix}"] = values
    lengths = Counter(top for top, _ in groups)
    sources: list[Source] = []
    for (top, length), columns in sorted(groups.items(), key=lambda item: -len(item[1])):
        base = top or path.stem
        first = all(source.name != base for source in sources)
        name = base if lengths[top] == 1 or first else f"{base}/{length}"
        sources.append(Source(name, path, columns))
    return sources


def _columns(array: NDArray[np.generic]) -> dict[str, Array]:
    """Columns (N,) of a vector or matrix by what is added to its name; none if it is neither."""
    if array.dtype.kind not in "biuf":
        return {}
    values = np.squeeze(array.astype(np.float64))
    if values.ndim == 1 and len(values) > 1:
        return {"": values}
    if values.ndim == 2 and min(values.shape) <= MOST_ELEMENTS:
        rows = values.T if values.shape[0] > values.shape[1] else values
        return {f"[{i}]": row for i, row in enumerate(rows)}
    return {}
