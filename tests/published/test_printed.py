"""The printed figures of each file stand in the source, at the table or section that is named."""

import os
import re
from pathlib import Path

import pytest

from seatrial.runner.compare.printed_figures import FOLDER, Printed, read_folder

SOURCES = {"Jervan": "000", "Ljungberg": "002", "Hoyer": "003", "Bargouth": "004"}
BEFORE, AFTER = 48, 12  # lines of a table stand before its caption, seldom behind it
NUMBER = re.compile(r"-?\d+(?:\.\d+)?")


def text_of(document: str) -> list[str]:
    """The lines of a source document."""
    folder = os.environ.get("SEATRIAL_DATA")
    seeds = Path(folder).parent / "seeds" if folder else Path("none")
    files = sorted(seeds.glob(f"{SOURCES[document.split()[0]]}_*.txt"))
    if not files:
        pytest.skip("no source documents beside the outside data")
    return files[0].read_text(encoding="utf-8").splitlines()


def place_of(figure: Printed) -> list[str]:
    """The lines about the table, figure or section of a printed figure."""
    lines = text_of(figure.document)
    name = re.sub(r"( under noise|Eq\. )", "", figure.table)
    if name.startswith("Section"):
        number = name.split()[1]
        after = number[:-1] + str(int(number[-1]) + 1)
        start = max(i for i, line in enumerate(lines) if re.match(rf"#* ?{number}\.? +[A-Z]", line))
        ends = [i for i, line in enumerate(lines) if re.match(rf"#* ?{after}\.? +[A-Z]", line)]
        return lines[start : max([*ends, start + 100])]
    exact = re.compile(re.escape(name) + r"(?!\d)", re.IGNORECASE)
    found = [i for i, line in enumerate(lines) if exact.search(line)]
    near = {k for i in found for k in range(max(0, i - BEFORE), i + AFTER)}
    return [lines[k] for k in sorted(near) if k < len(lines)]


def wordings(figure: Printed) -> list[str]:
    """What must stand in the source: the numbers as printed, or as the note says they are."""
    minutes = re.search(r"about ([\d.]+) min", figure.note)
    if minutes and float(minutes[1]) * 60.0 == figure.printed:
        return [minutes[1]]
    quoted = re.search(r"printed as (\d+) min (\d+) sec", figure.note)
    if quoted and 60 * int(quoted[1]) + int(quoted[2]) == figure.printed:
        return [f"{quoted[1]} min {quoted[2]} sec"]
    power = re.search(r"printed as (-?[\d.]+\^\d)", figure.note)
    return [power[1]] if power else figure.digits.split("/")


def stands(wording: str, lines: list[str]) -> bool:
    """Whether a number stands in the lines, with the printed digits."""
    text = "\n".join(lines)
    if re.fullmatch(r"[\d.]+e\d+", wording):
        mantissa, exponent = wording.split("e")
        return re.search(rf"{mantissa} ?(×|\\times) ?10\^{{?{exponent}", text) is not None
    if not NUMBER.fullmatch(wording):
        return wording in text
    return wording in NUMBER.findall(text)


@pytest.mark.parametrize("name", list(read_folder(FOLDER)))
def test_every_printed_figure_stands_in_its_source(name: str) -> None:
    places: dict[tuple[str, str], list[str]] = {}
    missing = []
    for figure in read_folder(FOLDER)[name]:
        if figure.printed is None:
            continue
        key = (figure.document, figure.table)
        places.setdefault(key, place_of(figure))
        missing += [
            f"{figure.table}, {figure.row}, {figure.quantity}: {wording}"
            for wording in wordings(figure)
            if not stands(wording, places[key])
        ]
    assert not missing


@pytest.mark.parametrize("stem", ["7_2", "7_3", "7_4", "a_4"])
def test_the_columns_of_a_recording_are_copied_line_by_line(stem: str) -> None:
    figures = read_folder(FOLDER)[f"hoyer_table_{stem}"]
    rows: dict[str, list[str]] = {}
    for figure in figures:
        if figure.name.startswith("statistic_") and figure.quantity != "duration":
            rows.setdefault(figure.row, []).append(figure.digits)
    assert len(rows) == 18
    lines = [line.split("\t") for line in place_of(figures[0])]
    for column, digits in rows.items():
        assert [column, *digits] in lines
