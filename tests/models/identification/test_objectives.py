"""The objective on a grid: its minimum, its islands, and what is refused."""

import numpy as np
import pytest

from seatrial.models.errors import ConfigurationError
from seatrial.models.excitation.signals import pulses
from seatrial.models.identification.objectives import local_minima

BOX = {"surge.u_dot": [10.0, 110.0], "surge.u": [5.0, 35.0]}


def value(found, name, **where):
    (one,) = [
        finding.value
        for finding in found.findings
        if finding.name == name and all(getattr(finding, k) == v for k, v in where.items())
    ]
    return one


@pytest.fixture
def on_grid(identifier, make):
    truth = make.surge(60.0, 20.0)
    problem = make.problem(truth, truth, pulses(0.1 * np.arange(400), (30.0,)))

    def found(objective):
        option = identifier("grid", bounds=BOX, integrator="euler", objective=objective, points=61)
        return option.identify(problem, np.random.default_rng(0))

    return found


def test_the_lowest_point_of_a_grid_that_has_it_is_the_truth(on_grid):
    found = on_grid("mae")
    assert found.model.theta[:, 0] == pytest.approx([60.0, 20.0], rel=1e-9)
    assert value(found, "objective", label="x") == pytest.approx(0.0, abs=1e-9)
    assert value(found, "topology", i=30, j=30) == pytest.approx(0.0, abs=1e-9)
    assert value(found, "topology_first", i=60) == 110.0
    assert value(found, "topology_second", i=0) == 5.0
    assert value(found, "topology", i=30, j=31) > 0.0


def test_islands_along_the_valley_come_of_the_mean_error(on_grid):
    """Hoyer (2021), Figure 7.20a, shows islands; the printed objective (6.4) has none."""
    printed, coded = (value(on_grid(name), "local_minima") for name in ("mae", "mean_error"))
    assert printed == 1.0
    assert coded > 5.0


def test_a_minimum_is_lower_than_all_its_neighbours():
    z = np.ones((5, 6))
    assert local_minima(z) == 0
    z[0, 0] = z[2, 2] = z[3, 4] = 0.0
    assert local_minima(z) == 2  # the one on the edge is not counted
    z[2, 3] = 0.0  # a pair of equals is a floor, no minimum
    assert local_minima(z) == 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"points": 1}, "points must be at least 2"),
        ({"parameters": ["surge.u"]}, r"got 1 \(surge.u\), expected two"),
        ({"bound_factor": None}, "bounds.surge.u_dot: got none"),
    ],
)
def test_wrong_options_are_refused(identifier, make, change, message):
    with pytest.raises(ConfigurationError, match=message):
        identifier("grid", **change).check(make.surge(60.0, 20.0), None, False)
