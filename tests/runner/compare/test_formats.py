"""What is written is what was meant, whatever letters are in it."""

import csv
import io
import json
import re
from xml.etree import ElementTree

from seatrial.runner.compare.grid import (
    OutputFormat,
    TableCell,
    TextTable,
    grid_of,
    number_text,
    render,
)
from seatrial.runner.compare.page import html_table

NASTY = 'a|b & 50 % of $x_1^2$ <b>"{é}\\'
GRID = TextTable(
    "about | tables",
    ("term", "value\n[N²]"),
    [
        [TableCell("|u|u"), TableCell("1.2 ± 0.1", bold=True, sort=1.2)],
        [TableCell(NASTY), TableCell("†")],
    ],
    notes=["a note <&"],
)


def test_figures_have_four_significant_digits() -> None:
    for value, text in (
        (0.0, "0"), (2757.4, "2757"), (12345.6, "12346"), (0.043124, "0.04312"),
        (9.99996, "10.00"), (-1.5, "-1.500"), (1.5e9, "1.500e+09"), (1.23456e-7, "1.235e-07"),
        (float("nan"), "nan"), (float("-inf"), "-inf"), (12, "12"),
    ):  # fmt: skip
        assert number_text(value) == text


def test_rich_keeps_brackets_and_is_never_cut_in_a_pipe() -> None:
    grid = grid_of("[bold]title", ("a", "b"), [["[red]x" * 40, 1.5]])
    shown = render(grid, OutputFormat.RICH)
    assert "[bold]title" in shown
    assert "[red]x" * 40 in shown
    assert "\x1b" not in shown
    assert "\x1b[1m" in render(GRID, OutputFormat.RICH, width=100, colour=True)


def test_markdown_rows_have_the_same_number_of_columns() -> None:
    lines = [line for line in render(GRID, OutputFormat.MD).splitlines() if line.startswith("|")]
    assert {line.replace("\\|", "").count("|") for line in lines} == {3}
    assert "**1.2 ± 0.1**" in lines[2]
    assert r"\|u\|u" in lines[2]
    assert "value<br>[N²]" in lines[0]


def test_latex_escapes_what_is_special() -> None:
    shown = render(GRID, OutputFormat.LATEX)
    assert r"\textbf{1.2 $\pm$ 0.1}" in shown
    assert r"\textbar{}u\textbar{}u" in shown
    assert r"50 \% of \$x\_1\textasciicircum{}2\$" in shown
    assert r"\shortstack{value \\ [N$^2$]}" in shown
    assert shown.count("{") == shown.count("}")


def test_html_is_well_formed_and_escaped() -> None:
    shown = str(html_table(GRID))
    quoted = re.sub(r"class=(\w+)", r'class="\1"', shown).replace("<br>", "<br/>")
    assert NASTY in [*ElementTree.fromstring(f"<div>{quoted}</div>").itertext()]
    assert 'data-value="1.2"' in shown
    assert "value<br>[N" in shown


def test_csv_and_json_read_back() -> None:
    grid = grid_of("", ("name", "value"), [["a,\nb", 0.1], ["c", None], ["d", float("nan")]])
    rows = list(csv.reader(io.StringIO(render(grid, OutputFormat.CSV))))
    assert rows == [["name", "value"], ["a,\nb", "0.1"], ["c", ""], ["d", ""]]
    assert [r["value"] for r in json.loads(render(grid, OutputFormat.JSON))] == [0.1, None, None]
    empty = grid_of("", ("name", "value"), [])
    assert render(empty, OutputFormat.CSV) == "name,value"
    assert json.loads(render(empty, OutputFormat.JSON)) == []
    assert json.loads(render(GRID, OutputFormat.JSON))[0] == {
        "term": "|u|u",
        "value [N²]": "1.2 ± 0.1",
    }
