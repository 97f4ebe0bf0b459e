"""What is stored of an informative mix and of its plan."""

import numpy as np
import pytest

from seatrial.runner.record.rows import Results
from seatrial.runner.trials import trial as trials
from tests.trials import composed

SHORT = (
    "vessel=modulus_ship", "excitation=optimal_design", "excitation.length_s=60", "identifier=iv",
    "controller=none",
)  # fmt: skip
ROUTE = (
    "excitation.route.area=[[0,0],[60,0],[60,40],[0,40]]", "excitation.route.start=[6,6,20]",
    "excitation.route.obstacles=[[[15,10],[30,10],[30,20]]]", "excitation.sub_experiments=4",
    "excitation.held_out=[four_corner]",
)  # fmt: skip


def values(results: Results, name: str) -> dict[str | None, float]:
    rows = [row for row in results.diagnostics if row.name == name]
    return {row.label: row.value for row in rows if row.value is not None}


def test_counts_shares_and_errors_are_stored() -> None:
    results = trials.run(composed(*SHORT))
    counts, shares = values(results, "mix_count"), values(results, "mix_share")
    assert len(counts) == len(shares) == 11
    assert sum(counts.values()) == 6.0
    assert sum(shares.values()) == pytest.approx(1.0)
    names = ("mix_gap", "mix_log_det", "mix_log_det_optimal")
    (gap,), (whole,), (best,) = (values(results, name).values() for name in names)
    assert gap <= 1e-6
    assert whole < best
    errors = {(m.model, m.dof): m.value for m in results.metrics
              if m.name == "velocity_rmse_free_run"}  # fmt: skip
    assert errors["identified", "sway"] == pytest.approx(0.0, abs=1e-4)  # exact without noise
    assert errors["nominal", "sway"] > 0.01  # it is 15 % heavier than the plant
    assert {one.kind for one in results.series} == {"recording", "residual", "prediction"}


def test_a_random_mix_has_no_shares() -> None:
    results = trials.run(composed(*SHORT, "excitation.design=random", "identifier=none"))
    assert not values(results, "mix_share")
    assert sum(values(results, "mix_count").values()) == 6.0


def test_a_plan_is_stored_with_its_waters() -> None:
    trial = composed(*SHORT, *ROUTE)
    trials.check(trial)
    results = trials.run(trial)
    series = {one.kind: one.columns for one in results.series}
    plan, waters = series["plan"], series["waters"]
    assert len(plan["t"]) == len(series["recording"]["t"]) + 1
    counts = {name: n for name, n in trial.excitation.counts.items() if n}
    names = list(trial.excitation.candidates)
    begun = np.flatnonzero((np.diff(plan["role"], prepend=0.0) > 0.0) & (plan["role"] == 1.0))
    trained = [names[int(plan["manoeuvre"][at])] for at in begun]
    assert {name: trained.count(name) for name in trained} == counts
    assert waters["polygon"].tolist() == [0.0] * 4 + [1.0] * 3
    assert (waters["x"][4], waters["y"][4]) == (15.0, 10.0)
    first = {name: series["recording"][name][0] for name in ("x", "y", "psi")}
    wanted = {"x": 6.0, "y": 6.0, "psi": np.radians(20.0)}
    assert first == pytest.approx(wanted, abs=1e-9)
    (clearance,) = values(results, "plan_clearance").values()
    (deviation,) = values(results, "plan_deviation").values()
    assert clearance >= 1.0
    assert deviation < 2.0
