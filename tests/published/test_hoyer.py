"""Hoyer (2021): the surge models."""

import numpy as np

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
