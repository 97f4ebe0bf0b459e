"""Logs of PX4 (ULog): a source a topic, by the package pyulog."""

from pathlib import Path

import numpy as np
from pyulog.core import ULog

from seatrial.models.errors import RecordingError
from seatrial.models.recording.formats.bounded import bounded
from seatrial.models.recording.source import (
    LARGEST_BYTES,
    ReadOptions,
    Source,
    TextArray,
    check_size,
)
from seatrial.models.vessel.basis import Array

EXPECTED = "a ULog file"
TIME = "timestamp"  # [us] since the autopilot started


def read(path: Path, options: ReadOptions) -> list[Source]:
    """The topics of a log, `topic` or `topic/1` for its further instances, with a `timestamp`.

    Raises RecordingError if it cannot be read.
    """
    if (size := path.stat().st_size) > LARGEST_BYTES:
        raise RecordingError(
            f"{path}: got {size / 1e6:.0f} MB, expected at most {LARGEST_BYTES / 1e6:.0f}; cut the "
            "recording"
        )
    sources = []
    with bounded(path, EXPECTED), path.open("rb") as file:  # pyulog leaves a bad file open
        topics = ULog(file).data_list
        check_size(path, sum(len(column) for topic in topics for column in topic.data.values()))
        for topic in topics:
            columns: dict[str, Array | TextArray] = {
                name: np.asarray(values, dtype=np.float64) for name, values in topic.data.items()
            }
            name = f"{topic.name}/{topic.multi_id}" if topic.multi_id else topic.name
            sources.append(Source(name, path, columns, {TIME: "us"}))
    if not sources:
        raise RecordingError(f"{path}: got no topic with data, expected {EXPECTED}")
    return sources
