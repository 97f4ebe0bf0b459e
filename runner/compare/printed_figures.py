"""Printed figures of published documents: what a line of a CSV file says, and reading it.

A file NAME.csv of printed figures belongs to the experiment NAME. Each line gives the place of a
figure (document, table, page, row, quantity), its printed value, and the stored number to compare
it with (where, source, stage, model, dof, name, label).
"""

import csv
import re
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

from seatrial.models.errors import ConfigurationError

FOLDER = Path(__file__).with_name("printed")
COLUMNS = (
    *("document", "table", "page", "row", "quantity", "printed", "reference", "unit"),
    *("way", "where", "source", "stage", "model", "dof", "name", "label", "factor"),
    *("compare", "statistic", "information", "note"),
)
SOURCES = ("metric", "coefficient", "diagnostic")
COMPARISONS = ("value", "lower", "higher", "truth", "one", "none")
CALIBRATED = "calibrated"  # our inputs were fitted to printed figures: agreement is no evidence
BY_CONSTRUCTION = "by construction"  # the method cannot but give the figure


@dataclass(frozen=True)
class Printed:
    """One printed figure, and the stored number to compare it with.

    `printed` holds what the document prints, also as a ratio of two printed figures (`0.20/0.42`);
    `reference` is a figure of ours, or one that follows from the document's words: it is shown with
    its ratio and not judged. `way` names our method if one printed figure is compared with several
    methods. `compare` says what is better: the printed `value` itself, a `lower` or `higher`
    figure, an estimate nearer to the stored `truth`, or the same distance to `one` (eigenvalues);
    `none` gives no verdict. A `model` such as `identified/nominal` is the ratio of the two within
    each run; `/nominal` divides the diagnostic `name` by that model's metric (`order_mse/
    force_mse`). Our value times `factor` has the printed unit. `information` says what our method
    knows in addition to the source (`a known thruster lag`); it is empty for the same data, split
    and knowledge. It begins with `calibrated` if our inputs were fitted to the printed figures, so
    that agreement is no evidence, and with `by construction` if the method cannot but give the
    figure. A figure without `source` cannot be reproduced, and `note` gives the reason; a row
    without `printed` has no printed counterpart. The `label` of a diagnostic is its label, its
    number i, both (`with JIT 100`), or its two numbers (`8,18`).
    """

    experiment: str
    document: str
    table: str
    page: str
    row: str
    quantity: str
    printed: float | None
    reference: float | None
    unit: str
    way: str
    where: str
    source: str
    stage: str
    model: str
    dof: str
    name: str
    label: str
    factor: float
    compare: str
    statistic: str
    information: str
    note: str
    digits: str = ""  # the printed figure as it is written
    rounding: float = 0.0  # half a unit of the last printed decimal

    @property
    def known(self) -> tuple[str, ...]:
        """The items of `information`."""
        return tuple(item for item in self.information.split("; ") if item)


def read_folder(folder: Path, experiment: str | None = None) -> dict[str, list[Printed]]:
    """Read the figures by experiment; raises ConfigurationError for an unknown name or a bad file.

    `folder` holds one CSV file for each experiment; without `experiment` all of them are read.
    """
    try:
        paths = sorted(folder.glob("*.csv"), key=lambda path: _sort_key(path.stem))
        files = {path.stem: path for path in paths if _has_columns(path)}
    except OSError as error:
        raise ConfigurationError(f"{folder}: cannot be read: {error.strerror}") from error
    if not files:
        raise ConfigurationError(f"{folder}: no files of printed figures in this folder")
    if experiment is not None:
        if experiment not in files:
            raise ConfigurationError(
                f"--experiment: got {experiment!r}, expected one of {', '.join(files)}"
            )
        files = {experiment: files[experiment]}
    return {name: read_file(path) for name, path in files.items()}


def _sort_key(name: str) -> list[tuple[str, int]]:
    """Return the sort key of a name: table_4_2 comes before table_4_10."""
    return [(text, int(digits or 0)) for text, digits in re.findall(r"(\D+)(\d*)", name)]


def _has_columns(path: Path) -> bool:
    with path.open(newline="", encoding="utf-8", errors="replace") as file:
        try:
            return tuple(next(csv.reader(file), ())) == COLUMNS
        except csv.Error:
            return False


def read_file(path: Path) -> list[Printed]:
    """Read the printed figures of one file; raises ConfigurationError with the wrong line."""
    try:
        with path.open(newline="", encoding="utf-8") as file:
            lines = list(csv.DictReader(file))
    except (UnicodeDecodeError, csv.Error) as error:
        raise ConfigurationError(f"{path.name}: not a CSV file in UTF-8: {error}") from error
    return [_printed(path.stem, line, f"{path.name}, line {i}") for i, line in enumerate(lines, 2)]


def _printed(experiment: str, line: Mapping[str, str], place: str) -> Printed:
    if None in line or None in line.values():
        raise ConfigurationError(f"{place}: expected {len(COLUMNS)} columns")
    text = {name: value.strip() for name, value in line.items()}
    text["source"], text["compare"] = text["source"] or "", text["compare"] or "value"
    for name, expected in (("source", ("", *SOURCES)), ("compare", COMPARISONS)):
        if text[name] not in expected:
            raise ConfigurationError(
                f"{place}: {name}: got {text[name]!r}, expected {', '.join(expected)}"
            )
    digits = number = text.pop("printed")
    try:
        printed, rounding = number_of(digits)
        number = text.pop("reference")
        reference = float(number) if number else None
        number = text.pop("factor")
        factor = float(number or 1.0)
    except (ValueError, ArithmeticError) as error:
        raise ConfigurationError(f"{place}: got {number!r}, expected a number") from error
    return Printed(
        experiment=experiment, printed=printed, factor=factor, rounding=rounding,
        digits=digits, reference=reference, **text,
    )  # fmt: skip


def number_of(digits: str) -> tuple[float | None, float]:
    """Return a printed number, or a ratio of two, and half a unit of its last decimal."""
    if not digits:
        return None, 0.0
    values = [float(part) for part in digits.split("/", 1)]
    units = [
        0.5 * 10.0 ** min(int(Decimal(part.strip()).as_tuple().exponent), 0)
        for part in digits.split("/", 1)
    ]
    if len(values) == 1:
        return values[0], units[0]
    ratio = values[0] / values[1]
    return ratio, units[0] / abs(values[1]) + abs(ratio) * units[1] / abs(values[1])
