"""The logbook: a results database that loses nothing.

The names below are imported when they are first used: SQLAlchemy takes a third of a second.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from runner.database.address import display_url, without_passwords
    from runner.database.reading import Reader
    from runner.database.records import (
        Answer,
        Begun,
        Coefficient,
        Diagnostic,
        Metric,
        Problem,
        Pruned,
        Results,
        RunDetail,
        RunStart,
        RunSummary,
        Series,
        SeriesFile,
        SweepStatus,
        SweepSummary,
        Verification,
    )
    from runner.database.repository import Logbook

_HOMES = {
    "Logbook": "repository",
    "Reader": "reading",
    "display_url": "address",
    "without_passwords": "address",
}

__all__ = [
    "Answer",
    "Begun",
    "Coefficient",
    "Diagnostic",
    "Logbook",
    "Metric",
    "Problem",
    "Pruned",
    "Reader",
    "Results",
    "RunDetail",
    "RunStart",
    "RunSummary",
    "Series",
    "SeriesFile",
    "SweepStatus",
    "SweepSummary",
    "Verification",
    "display_url",
    "without_passwords",
]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES.get(name, 'records')}"), name)
