"""Hoyer (2021): the surge models."""

from collections.abc import Callable

import numpy as np
import pytest

from seatrial.models.identification.problem import Problem
from seatrial.runner import closed_loop
from seatrial.runner import trial as trials
from seatrial.runner.record.rows import Results
from tests.trials import composed


def test_the_printed_drag_pushes_backward_and_ours_does_not() -> None:
    printed, ours = (
        composed(f"vessel={name}", "excitation=triple_ramp", "identifier=ls").vessel.nominal()
        for name in ("surge_nonlinear_printed", "surge_nonlinear")
    )
    assert printed.coefficient("surge", "u^2") == ours.coefficient("surge", "|u|u") == 2.0
    assert printed.coefficient("surge", "|u|u") == 0.0
    # power that the drag takes from the vehicle while it goes backward at 15 m/s
    speed = np.array([[-15.0]])
    for vessel, takes in ((ours, True), (printed, False)):
        force = vessel.inverse(np.zeros((1, 1)), speed)
        assert bool(force[0, 0] * speed[0, 0] > 0.0) == takes


@pytest.mark.slow
@pytest.mark.parametrize("excitation", ["triple_ramp", "many_sine"])
def test_the_search_finds_the_non_linear_model_on_every_seed(
    run: Callable[..., Results], excitation: str
) -> None:
    # Table 7.5: the printed estimates are 2 to 145 % off
    bounds = "++identifier.bounds={surge.u_dot:[10,120],surge.u:[1,40],surge.|u|u:[0,10]}"
    options = (
        "experiment=hoyer_table_7_5", f"excitation={excitation}", "identifier.polish=null",
        "identifier.population_cap=1000",
    )  # fmt: skip
    for seed in range(10):
        rows = run(*options, bounds, f"seed={seed}").coefficients
        found = [row for row in rows if row.model == "identified"]
        assert [row.term for row in found] == ["u_dot", "u", "|u|u"]
        assert [row.value for row in found] == pytest.approx([60.0, 20.0, 2.0], rel=0.01)


def test_mean_errors_vanish_at_two_printed_rows_of_table_7_5() -> None:
    # two of the three unknowns that solve both equations at the printed mass, printed digits
    printed = {"triple_ramp": (94.841, 15.872, 4.911), "many_sine": (96.101, 20.536, 2.0486)}
    for excitation, point in printed.items():
        trial = composed(
            "experiment=hoyer_table_7_5", "vessel=surge_nonlinear_printed",
            f"excitation={excitation}",
        )  # fmt: skip
        recording = trials.excite(trial, closed_loop.Streams(0)).recording
        problem = Problem(recording, recording, trial.vessel.nominal(), None)
        predictor = trial.identifier.predictor(problem)
        mean, mae = (
            predictor.errors(np.array([point]), metric)[0][0] for metric in ("mean_error", "mae")
        )
        assert np.all(mean < 0.03 * mae), excitation
