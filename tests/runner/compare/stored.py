"""Logbooks with known numbers in them, written as the runner writes them."""

from collections.abc import Mapping, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any

from runner.database import Logbook
from runner.database.records import Coefficient, Diagnostic, Metric, Results, RunStart, Series


def logbook_at(folder: Path) -> Logbook:
    return Logbook.open(f"sqlite:///{folder}/results.db", results_dir=folder)


def start(
    identifier: str = "ls",
    disturbance: str = "calm",
    seed: int = 0,
    vessel: str = "milliampere",
    config: Mapping[str, Any] | None = None,
    overrides: Sequence[str] = (),
) -> RunStart:
    """A run's start; its fingerprint says all that is given here."""
    whole = {
        "identifier": {"_target_": f"models.{identifier}", "force": "filtered"},
        "plant": {"scale": 0.5},
        "seed": seed,
        "lap": True,
        "lowpass_hz": None,
    }
    whole |= config or {}
    told = f"{identifier} {disturbance} {seed} {vessel} {sorted(whole.items(), key=str)}"
    return RunStart(
        fingerprint=sha256(told.encode()).hexdigest(),
        vessel=vessel,
        disturbance=disturbance,
        excitation="waypoints",
        identifier=identifier,
        controller="pid",
        evaluation="replay",
        seed=seed,
        config=whole,
        overrides=overrides or [f"identifier={identifier}", f"seed={seed}"],
        git_commit="0123456789abcdef",
        git_dirty=True,
        versions={"python": "3.11.7", "numpy": "2.4.6"},
        command=f"python -m runner identifier={identifier}",
    )


def force_mse(value: float | None, dof: str = "surge", model: str = "identified") -> Metric:
    unit = "(Nm)^2" if dof == "yaw" else "N^2"
    return Metric("validation", model, dof, "force_mse", value, unit)


def below(value: float, dof: str = "surge") -> Metric:
    return Metric("validation", "identified", dof, "below_true_model", value, "")


def tracking(value: float, model: str = "identified") -> Metric:
    return Metric("deployment", model, "position", "e_pos_mae", value, "m")


def coefficient(
    term: str,
    value: float,
    error: float | None,
    truth: float | None,
    dof: str = "surge",
    unit: str = "kg",
) -> Coefficient:
    return Coefficient("identified", dof, term, value, error, truth, unit)


def finish(
    logbook: Logbook,
    begin: RunStart,
    metrics: Sequence[Metric] = (),
    coefficients: Sequence[Coefficient] = (),
    diagnostics: Sequence[Diagnostic] = (),
    series: Sequence[Series] = (),
    rerun: bool = False,
) -> int:
    begun = logbook.begin_run(begin, rerun=rerun)
    assert begun.state == "new"
    logbook.finish_run(begun.run_id, Results(metrics, coefficients, diagnostics, series))
    return begun.run_id


def fail(logbook: Logbook, begin: RunStart, status: Any = "failed", error: str = "broken") -> int:
    begun = logbook.begin_run(begin)
    assert begun.state == "new"
    logbook.fail_run(begun.run_id, status, "ValueError", error, "Traceback: here\nValueError")
    return begun.run_id
