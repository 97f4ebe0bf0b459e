"""Trials of the sparse regression and of the Gaussian process, from the command line."""

from importlib.util import find_spec

import pytest

from tests.runner.command import Command
from tests.runner.programs import rows

PYSINDY = pytest.mark.skipif(
    find_spec("pysindy") is None, reason="no pysindy: pip install -e '.[rivals]'"
)
FREE_RUN = "SELECT model, value FROM metric WHERE name = 'velocity_rmse_free_run' AND dof = 'sway'"


@pytest.mark.parametrize(
    ("options", "disturbance", "diagnostic", "share"),
    [
        pytest.param(
            ("sparse", "identifier.algorithm=stlsq"), "calm", "selected_variables", 0.01,
            marks=PYSINDY,
        ),
        (("gaussian_process",), "noise", "projection_r2", 0.5),
    ],
)  # fmt: skip
def test_a_trial(
    seatrial: Command, options: tuple[str, ...], disturbance: str, diagnostic: str, share: float
) -> None:
    identifier, *more = options
    answer = seatrial(
        f"identifier={identifier}", *more, f"disturbance={disturbance}", "evaluation=none"
    )
    assert answer.code == 0, answer
    stored = rows(seatrial.folder, f"SELECT dof FROM diagnostic WHERE name = '{diagnostic}'")
    assert sorted(stored) == [("surge",), ("sway",), ("yaw",)]
    errors = dict(rows(seatrial.folder, FREE_RUN))
    assert errors["identified"] < share * errors["nominal"]
    (errors_are,) = rows(
        seatrial.folder,
        "SELECT count(*) FROM coefficient WHERE model = 'identified' AND std_error IS NOT NULL",
    )
    assert errors_are == (0,)
