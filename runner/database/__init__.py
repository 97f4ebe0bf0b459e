"""The logbook: the database of results.

The names below are imported at first use, because importing SQLAlchemy takes a third of a second.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from seatrial.runner.database.engine import display_url
    from seatrial.runner.database.logbook import Logbook
    from seatrial.runner.database.mask import without_passwords
    from seatrial.runner.database.reader import Reader
    from seatrial.runner.database.records import (
        Answer,
        Begun,
        Coefficient,
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


_HOMES = {
    "Logbook": "logbook",
    "Reader": "reader",
    "display_url": "engine",
    "without_passwords": "mask",
}
__all__ = [
    "Answer",
    "Begun",
    "Coefficient",
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
