"""Nothing is tuned on test files: an entrant finds the same model whatever is tested on.

Each entrant of a task, on the first seconds of its training data, with the test data permuted,
scaled and shortened.
"""

from dataclasses import replace

import numpy as np
import pytest

from seatrial.models.errors import IdentificationError
from seatrial.models.identification.problem import Problem
from seatrial.models.recording.recording import Recording
from seatrial.models.vessel.table import Vessel
from seatrial.runner.compare.benchmark.task import cells, task_of
from seatrial.runner.configuration.config import Trial
from seatrial.runner.trials.closed_loop import ExcitationData, Streams
from seatrial.runner.trials.trial import excite, identify
from tests.trials import composed

LEAST, SECONDS = 300, 60.0  # samples, and time, of the training data that are used
TASK = "blueboat"  # the quickest one; `test_benchmark` takes one entrant through all tasks


def excited() -> ExcitationData:
    """The recording of the task's first case whose files are there; else the test skips."""
    first = next(cells(task_of(TASK), ["none"]), None)
    if first is None:
        pytest.skip(f"the files of {TASK} are not there: needs SEATRIAL_DATA=FOLDER with them")
    trial = composed(*first.options)
    return excite(trial, Streams(trial.seed))


def problems(trial: Trial, data: ExcitationData) -> list[Problem]:
    """The same training data with different test data."""
    rows = np.flatnonzero(data.training)
    period = float(np.median(np.diff(data.recording.t)))
    training = data.recording.part(
        rows_of(data.recording, rows[: max(LEAST, int(SECONDS / period))])
    )
    testing = data.recording.part(data.testing)
    backward = replace(testing, nu=3.0 * testing.nu[::-1], eta=testing.eta[::-1])
    other = testing.part(slice(0, len(testing.t) // 2))
    return [
        Problem(training, held_out, trial.vessel.nominal(), trial.vessel.thruster)
        for held_out in (testing, backward, other)
    ]


def rows_of(recording: Recording, rows: np.ndarray) -> np.ndarray:
    mask = np.zeros(len(recording.t), dtype=bool)
    mask[rows] = True
    return mask


def found(trial: Trial, problem: Problem) -> tuple[str, np.ndarray]:
    """The model that is identified: its terms, coefficients and parameters of devices."""
    try:
        model: Vessel = identify(trial, problem, Streams(trial.seed))[0].model
    except IdentificationError as error:
        return str(error), np.zeros(0)
    terms = ", ".join(term.name for term in model.terms)
    return terms, np.concatenate([model.theta.ravel(), model.installed.parameters])


@pytest.mark.nightly
@pytest.mark.timeout(1800)
def test_the_model_does_not_depend_on_what_is_tested_on(subtests: pytest.Subtests) -> None:
    data, known = excited(), task_of(TASK)
    for entrant in known.entrants:
        with subtests.test(entrant):
            trial = composed(*next(cells(known, [entrant])).options)
            results = [found(trial, problem) for problem in problems(trial, data)]
            for terms, values in results[1:]:
                assert terms == results[0][0]
                np.testing.assert_array_equal(values, results[0][1])


def test_the_law_sees_an_entrant_that_looks_at_the_test_data() -> None:
    """Jervan's choice of the order by the test data, which no task has."""
    options = (
        "vessel=milliampere", "excitation=waypoints", "excitation.interval_s=60",
        "disturbance=noise", "evaluation=none", "identifier=plsr", "identifier.selection=test",
        "identifier.bootstrap=null",
    )  # fmt: skip
    trial = composed(*options)
    results = [found(trial, one) for one in problems(trial, excite(trial, Streams(trial.seed)))]
    assert any(not np.array_equal(values, results[0][1]) for _, values in results[1:])
