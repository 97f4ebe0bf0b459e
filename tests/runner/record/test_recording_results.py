"""Measured recordings through a whole trial: quality, and what makes them the same."""

from pathlib import Path

import numpy as np
import pytest

from seatrial.models.errors import RecordingError
from seatrial.runner.configuration.fingerprint import fingerprint
from seatrial.runner.trials import trial as trials
from tests.data import DATA
from tests.trials import composed

SURGE = ("vessel=surge_linear", "excitation=recording", "identifier=ls")


@pytest.mark.data
def test_surge_1_finishes_with_mass_and_damping(tmp_path: Path) -> None:
    trial = composed(
        *SURGE, f"excitation.path={DATA}/beluga/surge-1.csv", "excitation.start_s=410",
        "excitation.end_s=650",
    )  # fmt: skip
    trials.check(trial)
    results = trials.run(trial)
    found = {r.term: r for r in results.coefficients if r.model == "identified"}
    assert found["u_dot"].unit == "kg"
    assert found["u"].unit == "kg/s"
    for row in found.values():
        assert row.value > 0.0
        assert 0.0 < row.std_error < row.value
    assert "deployment" in (results.note or "")
    drift = {r.name: r.value for r in results.metrics if r.stage == "identification"}
    assert drift["integrated_velocity_error_max"] == pytest.approx(0.367, abs=0.01)


def write(path: Path, damping: float = 5.0) -> Path:
    """A recording of 20 kg with a damping [kg/s] that are pushed to and fro ahead."""
    t = 0.1 * np.arange(400)
    u = np.sin(0.5 * t) + 0.4 * np.sin(3.1 * t)
    force = 20.0 * np.gradient(u, 0.1) + damping * u
    rows = [f"{a:.10g},0,{b},{c}" for a, b, c in zip(t, u, force, strict=True)]
    path.write_text("\n".join(["Time,position_x,surge_vel,force_x", *rows]))
    return path


def test_the_same_data_elsewhere_is_the_same_trial(tmp_path: Path) -> None:
    prints = []
    for name, damping in (("first", 20.0), ("moved", 20.0), ("other", 21.0)):
        path = write(tmp_path / f"{name}.csv", damping)
        trial = composed(*SURGE, f"excitation.path={path}")
        prints.append(fingerprint(trial.config, trial.names, "sources"))
    assert prints[0] == prints[1] != prints[2]


def test_a_damaged_file_is_refused_before_any_work(tmp_path: Path) -> None:
    path = write(tmp_path / "bad.csv", 20.0)
    path.write_text(path.read_text().replace("0.5,", "oops,", 1))
    with pytest.raises(RecordingError, match="oops"):
        trials.check(composed(*SURGE, f"excitation.path={path}"))
