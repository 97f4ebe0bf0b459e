"""A trial to begin, results to store, and changes behind the logbook's back."""

import os
from datetime import UTC, datetime, timedelta

import numpy as np
from sqlalchemy import text, update

from seatrial.models.diagnostics import Diagnostic
from seatrial.runner.database import claims, engine
from seatrial.runner.database.engine import parse
from seatrial.runner.database.tables import RunRow
from seatrial.runner.record.rows import Coefficient, Metric, Results, Series


def make_start(trial: int = 0, **changes: object) -> RunRow:
    """A trial to begin; equal numbers are equal trials."""
    values: dict[str, object] = {
        "fingerprint": f"{trial:064x}", "vessel": "milliampere", "disturbance": "calm",
        "excitation": "waypoints", "identifier": "ls", "controller": "pid", "evaluation": "replay",
        "seed": trial, "config": {"plant": {"scale": 0.5}, "seed": trial},
        "overrides": ["identifier=ls"], "git_commit": "0" * 40, "git_dirty": False,
        "versions": {"python": "3.11"}, "command": "python -m runner identifier=ls",
    }  # fmt: skip
    return RunRow(**(values | changes))


def make_results(scale: float = 1.0) -> Results:
    """Every kind of result: 30 metrics, 100 coefficients, some diagnostics, a series."""
    t = np.arange(0.0, 10.0, 0.1)
    return Results(
        metrics=[
            Metric("validation", model, dof, name, scale * (1 + k), "N^2")
            for model in ("nominal", "identified")
            for dof in ("surge", "sway", "yaw")
            for k, name in enumerate(("force_mse", "force_mae", "nu_mse", "iaew", "own_metric"))
        ],
        coefficients=[
            Coefficient("identified", dof, f"term{k}", scale * k, 0.1, 2.0 * k, "kg")
            for dof in ("surge", "sway")
            for k in range(50)
        ],
        diagnostics=[Diagnostic("order_mse", "surge", scale / i, "N^2", i=i) for i in (1, 2, 3)],
        series=[Series("recording", {"t": t, "u": scale * np.sin(t)}, {"t": "s", "u": "m/s"})],
        note="deployment skipped",
    )


def change(url: str, *statements: object) -> None:
    """Execute statements on the database, which may break foreign keys."""
    writer = engine.writer(parse(url))
    with writer.connect() as connection:
        if parse(url).path:
            raw = connection.connection.dbapi_connection
            raw.execute("PRAGMA foreign_keys = OFF")  # type: ignore[union-attr]
        for one in statements:
            connection.execute(text(one) if isinstance(one, str) else one)  # type: ignore[call-overload]
        connection.commit()
    writer.dispose()


def ago(seconds: float) -> datetime:
    return datetime.now(UTC) - timedelta(seconds=seconds)


def gone() -> str:
    """The identity of a process of this machine that has ended."""
    own = claims.identity(os.getpid())
    assert own is not None
    machine, _, start = own.rsplit("/", 2)
    return f"{machine}/{2**22 + 1}/{start}"


def pretend(url: str, run_id: int, **values: object) -> None:
    """Change what the row of a run says."""
    change(url, update(RunRow).where(RunRow.id == run_id).values(**values))
