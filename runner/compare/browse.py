"""Opens a logbook in Datasette, with titles, descriptions, units and example queries.

Datasette is the extra `browse`. It listens on 127.0.0.1 only, and the file is opened read-only.
"""

import json
import subprocess
import sys
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.results import open_results
from seatrial.runner.database.engine import open_to_read
from seatrial.runner.database.tables import Base
from seatrial.runner.record.catalogue import METRICS

HOST = "127.0.0.1"
LICENCE_NOTE = "Numbers are SI, angles radians, unless a column `unit` says otherwise; times UTC."
TABLES = {
    "run_overview": "One row for each run: status, choices, headline metrics. Start here.",
    "metric_wide": "One row for each run, stage, model and DOF; one column for each metric.",
    "coefficient_error": "Identified and true coefficients, if the true value is not zero.",
    "sweep": "One start of the program with several trials.",
    "run": "One attempt at one trial: configuration, provenance, outcome.",
    "metric": "One figure of merit of a run, with its unit.",
    "coefficient": "One entry of a model of a run; a vessel can be rebuilt from these.",
    "diagnostic": "How an identification went: error over order, singular values, Pareto sets.",
    "series": "Files of sampled columns beside the database, with checksums.",
    "reuse": "Trials of a sweep that an earlier run had already completed.",
}
COLUMNS = {
    "fingerprint": "SHA-256 of the resolved configuration and of the code that computes results",
    "attempt": "counts the runs of one fingerprint",
    "superseded": "1 where another attempt at the same trial counts instead",
    "status": "running, finished, diverged, failed or interrupted",
    "heartbeat_at": "last heartbeat of a running run, UTC",
    "started_at": "UTC",
    "finished_at": "UTC",
    "duration_s": "wall time [s]",
    "stage": "identification, validation or deployment",
    "model": "nominal (believed), identified, plant (true) or residual",
    "dof": "degree of freedom, or position, heading, all",
    "unit": "unit of the value in this row",
    "std_error": "standard error of the estimate, in the row's unit",
    "true_value": "the plant's value, where it is known",
    "relative_error": "|value - true_value| / |true_value|",
    **{
        metric.name: f"{metric.formula} [{metric.units or '1'}]"
        for metric in METRICS
        if metric.wide
    },
}
QUERIES = {
    "compare_identifiers": (
        "Force error by identifier and disturbance",
        "SELECT identifier, disturbance, dof, count(*) AS n, avg(force_mse) AS mean_force_mse,"
        " avg(force_mse_filtered) AS mean_filtered FROM metric_wide WHERE stage = 'validation'"
        " AND model = 'identified' AND superseded = 0 GROUP BY identifier, disturbance, dof"
        " ORDER BY dof, disturbance, mean_force_mse",
    ),
    "tracking": (
        "Position error when deployed, nominal against identified",
        "SELECT identifier, disturbance, model, count(*) AS n, avg(e_pos_mae) AS mean_e_pos_mae_m"
        " FROM metric_wide WHERE stage = 'deployment' AND dof = 'position' AND superseded = 0"
        " GROUP BY identifier, disturbance, model ORDER BY disturbance, identifier, model",
    ),
    "failures": (
        "Runs that failed or diverged, with the reason",
        "SELECT run_id, status, identifier, disturbance, seed, error_type, error"
        " FROM run_overview WHERE status IN ('failed', 'diverged', 'interrupted')"
        " AND superseded = 0 ORDER BY run_id DESC",
    ),
    "worst_coefficients": (
        "Coefficients with the largest errors",
        "SELECT identifier, disturbance, dof, term, count(*) AS n,"
        " avg(relative_error) AS mean_relative_error FROM coefficient_error"
        " WHERE model = 'identified' AND superseded = 0 GROUP BY identifier, disturbance, dof, term"
        " ORDER BY mean_relative_error DESC LIMIT 100",
    ),
    "coefficients_of_a_run": (
        "The identified model of one run",
        "SELECT dof, term, value, std_error, true_value, unit FROM coefficient"
        " WHERE run_id = :run AND model = 'identified' ORDER BY dof, term",
    ),
}


def browse_database(database: str, port: int, open_browser: bool) -> int:
    """Serve the database until interrupted; return the exit code of Datasette.

    `database` is the URL or path of a SQLite logbook, `port` that on 127.0.0.1; `open_browser`
    opens a web browser. Raises ConfigurationError for PostgreSQL, and if Datasette is not
    installed.
    """
    with open_results(database) as results:
        path = results.reader.address.path
        columns = columns_of(path) if path else {}
    if path is None:
        raise ConfigurationError(
            "browse: Datasette reads SQLite; use a PostgreSQL client for PostgreSQL"
        )
    if find_spec("datasette") is None:
        raise ConfigurationError(
            "browse: Datasette is not installed: pip install 'seatrial[browse]'"
        )
    with TemporaryDirectory(prefix="seatrial-browse-") as folder:
        metadata = Path(folder) / "metadata.json"
        metadata.write_text(json.dumps(metadata_of(path, columns)), encoding="utf-8")
        command = [*arguments(path, metadata, port), *(["--open"] if open_browser else [])]
        return subprocess.run([sys.executable, "-m", "datasette", *command], check=False).returncode


def arguments(path: Path, metadata: Path, port: int) -> list[str]:
    """Return the arguments of Datasette: local host, no downloads, limited query time.

    `path` is the SQLite file, `metadata` the file with the titles, `port` that on 127.0.0.1.
    """
    settings = {"allow_download": "off", "sql_time_limit_ms": "10000", "max_returned_rows": "5000"}
    words = [word for name, value in settings.items() for word in ("--setting", name, value)]
    return ["serve", str(path), "--host", HOST, "--port", str(port), "-m", str(metadata), *words]


def metadata_of(path: Path, known: Mapping[str, list[str]]) -> dict[str, object]:
    """Return Datasette's metadata for tables and views with the `known` columns."""
    tables = {
        name: {
            "description": text,
            "columns": {c: COLUMNS[c] for c in known.get(name, []) if c in COLUMNS},
        }
        for name, text in TABLES.items()
    }
    queries = {name: {"title": title, "sql": sql} for name, (title, sql) in QUERIES.items()}
    return {
        "title": "Sea trials",
        "description": f"Runs, metrics and models stored by seatrial. {LICENCE_NOTE}",
        "databases": {path.stem: {"tables": tables, "queries": queries}},
    }


def columns_of(path: Path) -> dict[str, list[str]]:
    """Return the columns of every described table and view."""
    connection = open_to_read(path)
    try:
        names = set(TABLES) | {table.name for table in Base.metadata.sorted_tables}
        return {
            name: [
                row[0]
                for row in connection.execute("SELECT name FROM pragma_table_info(?)", [name])
            ]
            for name in sorted(names)
        }
    finally:
        connection.close()
