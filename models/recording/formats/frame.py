"""Data frames of pandas: one source."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from seatrial.models.recording.formats.titles import names_of
from seatrial.models.recording.source import Source, TextArray, check_size
from seatrial.models.vessel.basis import Array

if TYPE_CHECKING:
    import pandas as pd


def source_of_frame(frame: "pd.DataFrame", name: str = "frame") -> Source:
    """The columns of a data frame, and its index if it has a name; date-times as ISO text."""
    table = frame.reset_index() if frame.index.name is not None else frame
    check_size(Path(name), table.size)
    names, written, units, repeated = names_of([str(title) for title in table.columns])
    columns: dict[str, Array | TextArray] = {}
    for place, column in enumerate(names):
        if column not in repeated:
            columns[column] = _values(table.iloc[:, place])
    return Source(name, Path(name), columns, units, written, repeated)


def _values(series: "pd.Series[object]") -> Array | TextArray:
    if series.dtype.kind in "biuf":
        return np.asarray(series.to_numpy(dtype=np.float64, na_value=np.nan))
    moments = series.dtype.kind == "M"
    texts = series.map(lambda moment: moment.isoformat()) if moments else series.astype(str)
    return np.asarray(texts.to_numpy(dtype=np.object_))
