"""From zig-zags of HSVA to turning circles in the form of MARIN, through the command line."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from seatrial.models.identification.free_run import course_of, free_run
from seatrial.models.recording.recording import Recording
from seatrial.models.simulation.manoeuvre_sheet import track_of, turn
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel
from seatrial.runner.compare.__main__ import run as compare
from seatrial.runner.trials import trial as trials
from tests.data import DATA
from tests.runner.command import Command
from tests.trials import asked_for

SCALE, PERIOD_S = 45.7, 0.02
SHORT = ("Z_20_05", "Z_20_10_P", "Z_10_05", "Z_30_05")
FEW = ("identifier.horizon=100", "identifier.horizons=[]")


def hsva(*names: str) -> str:
    return json.dumps([f"{DATA}/kvlcc2/hsva/HSVA_CPMC_KVLCC2_{name}.dat" for name in names])


def circle(model: Vessel, rudder_deg: float, seconds: float = 90.0) -> Recording:
    """A turning circle of the model, at the speed and shaft speed of MARIN."""
    t = PERIOD_S * np.arange(round(seconds / PERIOD_S))
    delta = np.radians(np.clip(15.8 * (t - 2.0), 0.0, abs(rudder_deg))) * np.sign(rudder_deg)
    zero, nu = np.zeros((len(t), 3)), np.tile([1.18, 0.0, 0.0], (len(t), 1))
    inputs = np.column_stack([delta, np.full(len(t), 10.31)])
    named: dict[str, Any] = {"inputs": inputs, "input_names": ("delta", "n")}
    still = Recording(model.dofs, t, zero, nu, zero, zero, zero, **named)
    motion = free_run(model, course_of(still, None, None, None, 50.0), "rk4")
    return replace(still, eta=motion[:, :3], nu=motion[:, 3:])


def as_marin(path: Path, run: Recording) -> Path:
    """Write a run as MARIN does: of the ship, three digits, tabs, and empty rows at the end."""
    root, zero = np.sqrt(SCALE), np.zeros(len(run))
    psi, (u, v, r) = run.eta[:, 2], run.nu.T
    dx, dy = np.cos(psi) * u - np.sin(psi) * v, np.sin(psi) * u + np.cos(psi) * v
    assert run.inputs is not None
    delta, n = run.inputs.T
    table: Array = np.column_stack(
        [
            run.t * root, run.eta[:, :2] * SCALE, zero, np.degrees(psi), dx * root, dy * root,
            zero, np.degrees(r) / root, -np.degrees(delta), 60.0 * n / root,
        ]
    )  # fmt: skip
    rows = ["\t".join(f"{value:.2E}" for value in row) for row in table]
    head = ["MARIN(Maritime Research Institute Netherlands)", "Turning circle for KVLCC2", ""]
    path.write_text("\n".join([*head, *rows, *["\t" * 10] * 30]) + "\n")
    return path


@pytest.mark.data
@pytest.mark.slow
def test_turning_circles_are_predicted_and_measured(
    seatrial: Command, capsys: pytest.CaptureFixture[str]
) -> None:
    """The nominal model made the circles, so that its prediction is what was measured.

    The files have three digits: 1 m of a ship of 320 m below 1000 m, 10 m above.
    """
    train = hsva(*SHORT)
    nominal = asked_for("experiment=kvlcc2_turns").vessel.nominal()
    runs = {angle: circle(nominal, angle) for angle in (-35.0, 35.0)}
    files = [str(as_marin(seatrial.folder / f"tc_{a:g}.dat", runs[a])) for a in runs]
    tested = (f"excitation.train={train}", f"excitation.test={json.dumps(files)}")
    seatrial.succeeds("experiment=kvlcc2_turns", *tested, *FEW)
    capsys.readouterr()
    assert compare(["manoeuvres", "1", "--format", "json"]) == 0
    rows = {(row["file"], row["quantity"]): row for row in json.loads(capsys.readouterr().out)}
    for angle, run in runs.items():
        truth = turn(track_of(run, "delta", 7.0))
        for quantity in ("advance", "tactical diameter"):
            row = rows[f"tc_{angle:g}.dat", quantity]
            assert row["measured"] == pytest.approx(truth[quantity], rel=0.005)
            assert row["nominal model"] == pytest.approx(row["measured"], rel=0.005)
            error = 100.0 * (row["identified model"] / row["measured"] - 1.0)
            assert row["error [%]"] == pytest.approx(error)
            assert 0.0 < abs(error) < 15.0
            assert row["low"] < row["identified model"] < row["high"]
            assert row["low"] < row["measured"] < row["high"]  # the error of the model is in it
        assert rows[f"tc_{angle:g}.dat", "helm"]["measured"] == pytest.approx(angle, abs=0.1)


@pytest.mark.data
@pytest.mark.slow
def test_a_reduced_fit_predicts_better_than_the_untrained_model() -> None:
    tested = f"excitation.test={hsva('Z_25_05')}"
    options = (f"excitation.train={hsva(*SHORT)}", tested, "excitation.test_map=null")
    results = trials.run(asked_for("experiment=kvlcc2_turns", *options, *FEW))
    fits = {
        (row.model, row.dof): row.value or 0.0
        for row in results.metrics
        if row.name == "velocity_fit_free_run"
    }
    for dof in ("sway", "yaw"):
        assert fits["identified", dof] > fits["nominal", dof] + 8.0
        assert fits["identified", dof] > 85.0
    rms = {f.label for f in results.diagnostics if f.name == "prediction_rms"}
    assert rms == {"psi", "u", "v", "r", "propeller.thrust"}
