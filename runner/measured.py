"""What is stored of a measured recording beside its samples: statistics and quality checks."""

from models.quality import quality_checks, quality_series
from models.recorded import RecordedFile
from models.recording import Recording
from runner.database.records import Diagnostic, Metric, Series

STATISTICS = ("count", "mean", "std", "median", "minimum", "maximum")


def statistics(excitation: RecordedFile) -> list[Diagnostic]:
    """Descriptive statistics of the file's columns in the window, as recorded; i is the column."""
    return [
        Diagnostic(f"statistic_{name}", "all", i, None, column.name, getattr(column, name), "")
        for i, column in enumerate(excitation.describe())
        for name in STATISTICS
    ]


def outliers(excitation: RecordedFile, dofs: tuple[str, ...]) -> list[Diagnostic]:
    """How many samples of each column in use the file's outlier rule names."""
    counts = excitation.outlier_counts(dofs)
    return [
        Diagnostic("outliers", "all", i, None, column, count, "")
        for i, (column, count) in enumerate(counts.items())
    ]


def quality(recording: Recording) -> tuple[list[Metric], Series]:
    """Largest error of velocity against position, both ways, and the errors over time."""
    checks = quality_checks(recording)
    metrics = [
        Metric("identification", "plant", one.dof, f"{one.check}_error_max", one.maximum, one.unit)
        for one in checks
    ]
    columns, units = quality_series(checks)
    return metrics, Series("quality", {"t": recording.t, **columns}, {"t": "s", **units})
