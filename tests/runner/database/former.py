"""A logbook as the first revision left it."""

from sqlalchemy import text

from seatrial.runner.database import engine, schema
from seatrial.runner.database.engine import parse

FIRST_VIEW = "CREATE VIEW run_overview AS SELECT id, status, vessel FROM run"


def migrated(url: str, revision: str) -> None:
    """An empty database, brought to a revision by the migrations alone."""
    address = parse(url)
    if address.path is not None:
        address.path.parent.mkdir(parents=True, exist_ok=True)
    writer = engine.maker(address)
    with writer.begin() as connection:
        schema.migrate(connection, revision)
        if revision == "0001":
            connection.exec_driver_sql(FIRST_VIEW)
    writer.dispose()


def insert_first_results(url: str) -> None:
    """Two sweeps' worth of rows as the first revision wrote them."""
    writer = engine.writer(parse(url))
    run = (
        "INSERT INTO run (sweep_id, fingerprint, attempt, status, vessel, disturbance, excitation,"
        " identifier, controller, evaluation, seed, config, overrides, versions, host, pid,"
        " started_at) VALUES (1, :fingerprint, 1, :status, 'milliampere', 'calm', 'waypoints',"
        " 'ls', 'pid', 'replay', 0, '{}', '[]', '{}', 'boat', 1, '2026-01-02 03:04:05.000000')"
    )
    with writer.begin() as connection:
        connection.execute(
            text(
                "INSERT INTO sweep (name, command, overrides, planned, started_at, host, pid)"
                " VALUES ('s', 'c', '[]', 2, '2026-01-02 03:04:05.000000', 'boat', 1)"
            )
        )
        for number, status in enumerate(("finished", "running")):
            connection.execute(text(run), {"fingerprint": f"{number:064x}", "status": status})
        for number in (1, 2):
            connection.execute(
                text(
                    "INSERT INTO metric (run_id, stage, model, dof, name, value, unit)"
                    " VALUES (:run, 'validation', 'plant', 'surge', 'force_mse', 2.5, 'N^2')"
                ),
                {"run": number},
            )
    writer.dispose()
