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

    @property
    def frame(self) -> "pd.DataFrame":
        """The numbers at full precision, one row a record, as `--format json` writes them."""
        return pd.DataFrame.from_records(list(self._grid.as_records()))

    @property
    def notes(self) -> tuple[str, ...]:
        """The notes under the table."""
        return tuple(self._grid.notes)

    def text(self, form: str = "rich") -> str:
        """Return the table in a format of the shell.

        Parameters
        ----------
        form
            rich, md, csv, latex, json or html.

        Returns
        -------
        str
            The table and its notes.

        Raises
        ------
        ConfigurationError
            There is no such format.
        """
        known = [each.value for each in OutputFormat]
        if form not in known:
            raise ConfigurationError(f"text: got {form!r}, expected one of {', '.join(known)}")
        return render(self._grid, OutputFormat(form))

    def __str__(self) -> str:
        return self.text()

    def __repr__(self) -> str:
        return self.text()

    def _repr_html_(self) -> str:
        return self.text("html")
