"""A trial to begin and results to store."""

import numpy as np

from seatrial.models.diagnostics import Diagnostic
from seatrial.runner.database import RunStart
from seatrial.runner.record.rows import Coefficient, Metric, Results, Series


def make_start(trial: int = 0, **changes: object) -> RunStart:
    """A trial to begin; equal numbers are equal trials."""
    values: dict[str, object] = {
        "fingerprint": f"{trial:064x}",
        "vessel": "milliampere",
        "disturbance": "calm",
        "excitation": "waypoints",
        "identifier": "ls",
        "controller": "pid",
        "evaluation": "replay",
        "seed": trial,
        "config": {"plant": {"scale": 0.5}, "seed": trial},
        "overrides": ["identifier=ls"],
        "git_commit": "0" * 40,
        "git_dirty": False,
        "versions": {"python": "3.11"},
        "command": "python -m runner identifier=ls",
    }
    return RunStart(**(values | changes))  # type: ignore[arg-type]


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
