"""The logbook: the database of results.

The modules and names below are imported at first use (SPEC 1 of Scientific Python), because
importing SQLAlchemy takes a third of a second.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from seatrial.runner.database import engine as engine
    from seatrial.runner.database import outage as outage
    from seatrial.runner.database import schema as schema
    from seatrial.runner.database import tables as tables
    from seatrial.runner.database.logbook import LogbookWriter as LogbookWriter
    from seatrial.runner.database.reader import LogbookReader as LogbookReader
    from seatrial.runner.database.records import RunDetail as RunDetail
    from seatrial.runner.database.records import RunSummary as RunSummary
else:
    import lazy_loader

    names = {"logbook": ["LogbookWriter"], "reader": ["LogbookReader"]}
    names["records"] = ["RunDetail", "RunSummary"]
    __getattr__, __dir__, __all__ = lazy_loader.attach(
        __name__, ["engine", "outage", "schema", "tables"], names
    )
