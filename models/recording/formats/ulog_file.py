"""Logs of PX4 (ULog): a source a topic, by the package pyulog."""

from pathlib import Path

import numpy as np
from pyulog.core import ULog

from seatrial.models.errors import RecordingError
from seatrial.models.recording.source import ReadOptions, Source, check_file, check_size, foreign

EXPECTED = "a ULog file"
TIME = "timestamp"  # [us] since the autopilot started


def read(path: Path, options: ReadOptions) -> list[Source]:
    """The topics of a log, `topic` or `topic/1` for its further instances, with a `timestamp`.

    Raises RecordingError if it cannot be read.
    """
    check_file(path)
    with foreign(path, EXPECTED), path.open("rb") as file:  # pyulog leaves a bad file open
        topics = ULog(file).data_list
        check_size(path, sum(len(column) for topic in topics for column in topic.data.values()))
        sources = [
            Source(
                f"{topic.name}/{topic.multi_id}" if topic.multi_id else topic.name,
                path,
                {name: np.asarray(v, dtype=np.float64) for name, v in topic.data.items()},
                {TIME: "us"},
            )
            for topic in topics
        ]
    if not sources:
        raise RecordingError(f"{path}: got no topic with data, expected {EXPECTED}")
    return sources
