"""A table of the comparison, as a notebook and a program see it."""

from typing import TYPE_CHECKING

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.formats import OutputFormat, render
from seatrial.runner.compare.grid import TextTable

if TYPE_CHECKING:
    import pandas as pd
else:
    import lazy_loader

    pd = lazy_loader.load("pandas")


class Table:
    """A table with its notes: text for readers, a frame for programs.

    `str(table)` is what the shell prints, a notebook shows the same as HTML.
    """

    def __init__(self, grid: TextTable) -> None:
        self._grid = grid
        self.notes = tuple(grid.notes)

    @property
    def frame(self) -> "pd.DataFrame":
        """The numbers at full precision, one row a record, as `--format json` writes them."""
        return pd.DataFrame.from_records(list(self._grid.as_records()))

    def text(self, form: str = "rich") -> str:
        """Return table and notes in a format of the shell: rich, md, csv, latex, json or html.

        Raises ConfigurationError for any other format.
        """
        known = [each.value for each in OutputFormat]
        if form not in known:
            raise ConfigurationError(f"text: got {form!r}, expected one of {', '.join(known)}")
        return render(self._grid, OutputFormat(form))

    def __repr__(self) -> str:
        return self.text()

    def _repr_html_(self) -> str:
        return self.text("html")
