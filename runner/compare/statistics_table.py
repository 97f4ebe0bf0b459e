"""The statistics of a measured recording that a run stored of its file."""

from models.errors import LogbookError

from .grid import Grid, Scalar, grid_of
from .results import Results

HEADERS = ("column", "N", "mean", "std", "median", "min", "max")
NAMES = ("count", "mean", "std", "median", "minimum", "maximum")


def recording_statistics(results: Results, run_id: int, digits: int) -> Grid:
    """N, mean, standard deviation, median, minimum and maximum of every column, as recorded.

    Raises LogbookError for a run that has none: only measured files are described.
    """
    reader = results.reader
    reader.run(run_id)
    stored = {
        (row.i, row.label, row.name.removeprefix("statistic_")): row.value
        for row in reader.diagnostics(run_id)
        if row.name.startswith("statistic_")
    }
    columns = sorted({(i or 0, label or "") for i, label, _ in stored})
    if not columns:
        raise LogbookError(
            f"run {run_id} has no statistics; expected a run of a measured file "
            "(excitation=recording)"
        )
    rows: list[list[Scalar]] = [
        [label, *(stored.get((i, label, name)) for name in NAMES)] for i, label in columns
    ]
    return grid_of(f"recording of run {run_id}, as measured", HEADERS, rows, 1, digits=digits)
