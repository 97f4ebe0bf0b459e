"""What is timed is the same prediction, and every n and way has a time; none is asserted."""

import numpy as np
import pytest

from seatrial.models.errors import ConfigurationError
from seatrial.models.identification.prediction_times import WAYS


@pytest.mark.slow
def test_every_way_is_timed(identifier, make, signal):
    truth = make.surge(60.0, 20.0)
    problem = make.problem(truth, truth, signal("triple_ramp"))
    option = identifier("prediction_times", calls=[1, 5], interpreted_calls=[1])
    found = option.identify(problem, np.random.default_rng(0))
    assert found.model is problem.nominal
    times = {(f.name, f.label, f.i): f.value for f in found.findings}
    for way in WAYS:
        for n in (1,) if way == WAYS[0] else (1, 5):
            with_compilation = times["prediction_time", way, n]
            assert with_compilation >= times["prediction_time_compiled", way, n] > 0.0
    assert len(times) == 10


@pytest.mark.parametrize("numbers", [[], [0, 1], [3, 2], [2, 2]])
def test_numbers_of_calls_rise_from_one(identifier, numbers):
    with pytest.raises(ConfigurationError, match="must be increasing positive numbers"):
        identifier("prediction_times", calls=numbers)
