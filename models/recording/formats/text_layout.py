"""Where the columns of a text file stand: separator, header lines, names and units."""

import csv
import io
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from seatrial.models.errors import RecordingError
from seatrial.models.recording.formats.titles import Names, names_of
from seatrial.models.recording.source import TextOptions, is_empty

SEPARATORS = "\t;|,"  # in this order where they fit equally well
SAMPLE_LINES = 60  # that the layout is found from
MOST_HEADER_LINES = 5
MOST_COLUMNS = 10_000
LONGEST_LINE = 10**6  # bytes
WHITE_LINE = re.compile(rb"^[ \t]+(?=\r?$)", re.MULTILINE)
WHITE = re.compile(rb"[ \t\v\f]+")
NUMBER_TEXT = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
COMMA_NUMBER = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?", re.ASCII)
DATE = re.compile(r"\d{4}[-/.]\d\d?[-/.]\d\d?|\d\d?:\d\d", re.ASCII)


@dataclass(frozen=True, eq=False)
class TextLayout:
    """The text of a file, and where its table stands in it."""

    data: bytes  # UTF-8, without comments
    separator: str
    decimal: str
    header: list[list[str]]  # lines of names; empty if the columns have none
    width: int  # columns
    lines_before: int  # the first row
    rows_before: int  # the same, without blank lines
    given: tuple[str, ...]  # names by option

    def named(self) -> Names:
        """Names of the columns: given, from the header, or c1, c2 ...; with the units."""
        titles = [cell.strip() for cell in self.header[0]] if self.header else [""] * self.width
        below = [cell.strip() for cell in self.header[1]] if len(self.header) > 1 else []
        return names_of(self.given or titles, below if len(below) == self.width else ())


def layout_of(path: Path, data: bytes, text: TextOptions) -> TextLayout:
    """Find the layout of a text; raises RecordingError if it has no rows."""
    data, commented = _without_comments(WHITE_LINE.sub(b"", data), text.comment)
    if text.skip_lines:
        parts = data.split(b"\n", text.skip_lines)
        data = b"\n" * text.skip_lines + (parts[-1] if len(parts) > text.skip_lines else b"")
    separator = text.separator or _separator(data)
    white = separator == " "
    if white:
        lines = data.split(b"\n")
        if (longest := max(map(len, lines))) > LONGEST_LINE:
            raise RecordingError(
                f"{path}: got a line of {longest} bytes, expected at most {LONGEST_LINE}"
            )
        data = b"\n".join(WHITE.sub(b"\t", line.strip()) for line in lines)
        separator = "\t"
    free = TextLayout(data, separator, ".", [], 0, 0, 0, text.names)
    head = list(islice(cells(path, free), SAMPLE_LINES))
    decimal = text.decimal or _decimal(head, separator)
    preamble, header = _header(head, text, decimal, white)
    before = preamble + header
    if len(head) <= before:
        raise RecordingError(f"{path}: got a header and no rows, expected samples below it")
    titles = [row for _, row in head[preamble:before]]
    width = len(titles[0]) if titles else len(head[before][1])
    if width > MOST_COLUMNS:
        raise RecordingError(f"{path}: got {width} columns, expected at most {MOST_COLUMNS}")
    if not titles and commented is not None and not text.names:
        words = _cut(commented, separator)
        words = commented.split() if len(words) != width else words
        titles = [words] if len(words) == width and not any(map(is_number, words)) else []
    if text.names and len(text.names) != width:
        raise RecordingError(
            f"{path}: got {width} columns, expected {len(text.names)} as in excitation.text.names"
        )
    line = head[before - 1][0] if before else 0
    return TextLayout(data, separator, decimal, titles, width, line, before, text.names)


def cells(path: Path, layout: TextLayout) -> Iterator[tuple[int, list[str]]]:
    """The line number on which each row ends, and its cells; blank lines are skipped."""
    lines = io.TextIOWrapper(io.BytesIO(layout.data), encoding="utf-8", newline="")
    reader = csv.reader(lines, delimiter=layout.separator)
    try:
        for row in reader:
            if row:
                yield reader.line_num, row
    except csv.Error as error:
        raise RecordingError(
            f"{path}, line {reader.line_num}: {error}, expected comma-separated values"
        ) from error


def is_number(cell: str, decimal: str = ".") -> bool:
    """Whether a cell is a number."""
    text = cell.strip()
    return bool(NUMBER_TEXT.fullmatch(text.replace(decimal, ".") if decimal != "." else text))


def _without_comments(data: bytes, mark: str | None) -> tuple[bytes, str | None]:
    """The text with empty lines in place of comments, and the last comment before the table."""
    if not mark:
        return data, None
    sign = re.escape(mark.encode())
    pattern = re.compile(rb"^[ \t]*" + sign + rb"[^\r\n]*", re.MULTILINE)
    if not pattern.search(data):
        return data, None
    leading = re.match(rb"(?:[ \t]*(?:" + sign + rb"[^\r\n]*)?\r?\n)+", data)
    lines = leading[0].decode().split("\n") if leading else []
    titles = [line.strip().removeprefix(mark).strip() for line in lines if line.strip()]
    return pattern.sub(b"", data), titles[-1] if titles else None


def _separator(data: bytes) -> str:
    """The separator that cuts most lines into equally many cells."""
    lines = [line for line in data[:65536].decode(errors="replace").split("\n") if line.strip()]
    lines = lines[:SAMPLE_LINES]
    best, most = ",", 0
    for candidate in SEPARATORS:
        counts = Counter(len(_cut(line, candidate)) for line in lines)
        counts.pop(1, None)
        counts.pop(0, None)
        agreeing = max(counts.values(), default=0)
        if agreeing > most:
            best, most = candidate, agreeing
    numbers = [line for line in lines if line.split() and all(map(is_number, line.split()))]
    if 2 * most < len(lines) and numbers and len(numbers[0].split()) > 1:
        return " "
    return best


def _cut(line: str, separator: str) -> list[str]:
    try:
        return next(csv.reader([line], delimiter=separator), [])
    except csv.Error:
        return []


def _decimal(head: list[tuple[int, list[str]]], separator: str) -> str:
    found = [cell.strip() for _, row in head for cell in row]
    commas = sum(bool(COMMA_NUMBER.fullmatch(cell)) for cell in found)
    points = sum("." in cell and is_number(cell) for cell in found)
    return "," if separator != "," and commas > points else "."


def _header(
    head: list[tuple[int, list[str]]], text: TextOptions, decimal: str, white: bool
) -> tuple[int, int]:
    """Rows before the header, and rows of the header."""
    if text.header_lines is not None:
        return 0, text.header_lines
    # Between white space, the words of a title are cells: a sample has nothing but numbers.
    every = all if white else any
    samples = [every(_samples(row, decimal)) for _, row in head]
    first = samples.index(True) if True in samples else None
    if first == 0:
        return 0, 0
    width = len(head[0][1]) if first is None else len(head[first][1])
    # Lines of one cell, or of another length than the samples, are a title.
    starts = [i for i, (_, row) in enumerate(head[:first]) if len(row) == width]
    if first is None or not starts:
        title = first is not None and (white or first > 1 or len(head[0][1]) == 1 < width)
        return (first or 0, 0) if title else (0, 1)
    header = first - starts[0]
    return starts[0], header if header <= MOST_HEADER_LINES else 1


def _samples(row: list[str], decimal: str) -> list[bool]:
    """Whether the cells of a row hold numbers or date-times, rather than names or units."""
    filled = [cell for cell in row if not is_empty(cell)]
    return [is_number(cell, decimal) or bool(DATE.match(cell.strip())) for cell in filled]
