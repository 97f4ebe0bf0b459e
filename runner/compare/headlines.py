"""The tables that pages show of some runs, and what the first of them says in words."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.cli import TableOptions, axes_of
from seatrial.runner.compare.frame import Queries, StoredRun
from seatrial.runner.compare.grid import Scalar, TextTable, number_text, unit_text
from seatrial.runner.compare.table import comparison
from seatrial.runner.record.catalogue import all_declared, definition_of

# The metrics that have a table, and whether the table is unfolded at first.
TABLES = {
    "e_pos_mae": True,
    "e_psi_mae": True,
    "velocity_rmse_free_run": True,
    "force_mse": True,
    "force_mse_filtered": False,
    "velocity_rmse_one_step": False,
    "coefficient_error": False,
    "error_mae": False,
    "steady_state_error": False,
    "tau_mean_abs": False,
    "power_mean": False,
    "iaew": False,
}
WORDS = {
    **{"dof": "axis", "run_id": "run", "started_at": "started", "duration_s": "duration [s]"},
    "below_true_model": "below the true model",
}


@dataclass(frozen=True)
class Headline:
    """A table of a headline metric, unfolded if `shown`, and the words of its command."""

    metric: str
    rows: str
    columns: str
    table: TextTable
    shown: bool
    command: Sequence[str]
    baseline: bool = False


def headlines(
    results: Queries, runs: Sequence[StoredRun], options: TableOptions
) -> tuple[list[Headline], list[str]]:
    """Return the tables of some runs, and messages on those whose runs differ in too much.

    `options` have the selection of the runs, the rows and the columns. The baseline is the level
    `none` of the rows, if some of the runs have it.
    """
    rows, columns = axes_of(options.rows, options.columns)
    levels = {run.levels.get(rows) for run in runs}
    baseline = [f"{rows}=none"] if "none" in levels and len(levels) > 1 else []
    chosen = {"--where": options.where, "--sweep": options.sweep}
    named = {"--rows": rows, "--columns": columns, "--baseline": ",".join(baseline), **chosen}
    words = [word for pair in named.items() if pair[1] for word in map(str, pair)]
    stored, found, messages = results.metric_names(), [], []
    for metric, shown in TABLES.items():
        if metric in stored:
            try:
                table = comparison(results, replace(options, metric=[metric], baseline=baseline))
            except ConfigurationError as error:
                messages.append(f"{definition_of(metric).heading}: {error}")
                continue
            if any(cell.sort is not None for row in table.rows for cell in row):
                command = ["table", "--metric", metric, *words]
                found.append(Headline(metric, rows, columns, table, shown, command, bool(baseline)))
    return found, messages


def answers(headline: Headline) -> Iterator[str]:
    """Say which row is best under each condition, and by how much it beats the baseline."""
    label, table = definition_of(headline.metric).label, headline.table
    for record in table.as_records():
        value = record.get("mean")
        if record["best"] and isinstance(value, float):
            names = [name for name in (*table.headers, headline.columns) if name in record]
            others = [str(record[n]) for n in names if n not in (headline.rows, "unit", "metric")]
            size = f"{number_text(value, 3)} {unit_text(str(record['unit']))}".rstrip()
            text = f"{record[headline.rows]} has a {label[0].lower()}{label[1:]} of {size}"
            yield f"{', '.join(others) or 'all runs'}: {text}{_beaten(record)}."


def _beaten(record: Mapping[str, Scalar]) -> str:
    """Return the words on the pairs of a record with its baseline; empty without any."""
    ratio, wins, pairs, lost = (record.get(n) for n in ("ratio", "wins", "pairs", "lost_pairs"))
    if not (
        isinstance(ratio, float) and isinstance(pairs, int) and isinstance(lost, int) and pairs
    ):
        return ""
    baseline = str(record["baseline"]).partition("=")[2]
    size = f"{number_text(1.0 / ratio, 2)} times less than" if 0.0 < ratio < 1.0 else "no less than"
    return f", {size} {baseline}, better in {wins} of {pairs + lost} pairs"


def in_words(grid: TextTable) -> TextTable:
    """Return a table with the labels of metrics, and words for columns, instead of their keys."""
    return replace(
        grid,
        title=_labelled(grid.title),
        headers=[WORDS.get(header, header.replace("_", " ")) for header in grid.headers],
        notes=[_labelled(note) for note in grid.notes],
    )


def _labelled(text: str) -> str:
    """Return a text with the labels of the metrics that it names."""
    labels = {definition.name: definition.label for definition in all_declared()}
    return re.sub(r"\b[a-z]\w*_\w+\b", lambda name: labels.get(name[0], name[0]), text)
