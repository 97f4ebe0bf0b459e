"""Workbooks of Excel: a source a sheet, read like the text that its cells would be."""

import csv
import io
from datetime import date, time
from pathlib import Path

import openpyxl

from seatrial.models.errors import RecordingError
from seatrial.models.recording.formats.text import table
from seatrial.models.recording.source import ReadOptions, Source, TextOptions, check_size, foreign


def read(path: Path, options: ReadOptions) -> list[Source]:
    """The tables of a workbook; raises RecordingError if it cannot be read or has none."""
    sources, left_out = [], []
    with foreign(path, "a workbook of Excel (.xlsx)"):
        book = openpyxl.load_workbook(path, read_only=True, data_only=True)
        for sheet in book.worksheets:
            check_size(path, (sheet.max_row or 0) * (sheet.max_column or 0))
            rows = [_texts(row) for row in sheet.iter_rows(values_only=True)]
            width = max(map(len, rows), default=0)
            written = io.StringIO()
            writer = csv.writer(written, lineterminator="\n")
            for row in rows:
                writer.writerow([*row, *[""] * (width - len(row))] if row else [])
            text = TextOptions(",", ".", None, None, options.text.skip_lines,
                               options.text.header_lines, options.text.names)  # fmt: skip
            try:
                sources.append(table(path, written.getvalue().encode(), text, sheet.title))
            except RecordingError as error:
                left_out.append(f"sheet {sheet.title}: {str(error).removeprefix(f'{path}: ')}")
        book.close()
    if not sources:
        raise RecordingError(f"{path}: {'; '.join(left_out)}, expected a sheet with a table")
    return [Source(**{**vars(sources[0]), "left_out": (*left_out, *sources[0].left_out)}),
            *sources[1:]]  # fmt: skip


def _texts(row: tuple[object, ...]) -> list[str]:
    """The cells of a row as text, without empty ones at its end."""
    cells = [
        "" if cell is None else cell.isoformat() if isinstance(cell, date | time)
        else str(int(cell)) if isinstance(cell, bool) else str(cell) for cell in row
    ]  # fmt: skip
    while cells and not cells[-1]:
        cells.pop()
    return cells
