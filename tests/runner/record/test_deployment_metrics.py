"""Rows of a trial: errors of coefficients."""

import numpy as np
import pytest

from seatrial.models.identification.problem import Identified
from seatrial.models.recording.recording import Recording
from seatrial.models.vessel.basis import terms
from seatrial.models.vessel.table import Vessel
from seatrial.runner.trials import validation_metrics


def vessel(**values: float) -> Vessel:
    """A vessel in surge; `uu` stands for |u|u and `air` for |u_q|u_q."""
    names = {"uu": "|u|u", "air": "|u_q|u_q"}
    found = terms(names.get(name, name) for name in values)
    return Vessel("test", ("surge",), found, np.array([list(values.values())]).T)


def test_the_median_error_is_over_the_vessels_own_terms() -> None:
    still = np.zeros((3, 1))
    recording = Recording(
        ("surge",), np.arange(3.0), still, still, still, still, np.zeros((3, 3)),
        wind=np.zeros((3, 2)),
    )  # fmt: skip
    nominal = vessel(u_dot=100.0, u=10.0, uu=5.0)
    truth = vessel(u_dot=100.0, u=20.0, uu=4.0, air=7.0)  # errors 0, 0.5 and 0.25; wind's is 1
    found = validation_metrics.validation(recording, nominal, Identified(truth, truth), truth)
    errors = {row.model: row.value for row in found if row.name == "coefficient_error_median"}
    assert errors == {"nominal": pytest.approx(0.25), "identified": 0.0}
