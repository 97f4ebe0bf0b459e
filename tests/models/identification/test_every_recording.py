"""Identifiers on vessels and a measured recording: it works, or says why it cannot.

Every identifier with every vessel, in `make nightly`. The
recordings are the Beluga's; for another vessel they are only columns of numbers. Small options:
what is found is the business of the other tests.
"""

from itertools import product

import numpy as np
import pytest

from seatrial.models.errors import ConfigurationError, IdentificationError
from seatrial.runner.trials import trial as trials
from tests.data import DATA
from tests.trials import FORCED, composed, options

APART = {"command"}  # runs a program
IDENTIFIERS = sorted({*options("identifier")} - APART)
SMALL = {
    "dsr": ["L=3", "J=6", "bootstrap=20"],
    "output_error": ["horizons=[30]", "horizon=100"],
    "nsga2": ["population=8", "generations=2", "polish=null"],
    "nsga2_thesis": ["population=8", "generations=2"],
    "plsr": ["bootstrap=null"],
    "surface_plsr": ["bootstrap=null", "folds=2"],
    "auto": ["candidates.plsr.bootstrap=null", "folds=2"],
}
# What a recording of a minute may not determine, and the words of the reason.
REASONS = {
    "dsr": "windows of|physical form|inertia|pose and velocity|order",
    "iv": "instruments",
    "ls": "does not distinguish",
    "output_error": "does not determine|does not distinguish|hardly positive definite",
}

pytestmark = pytest.mark.data


def recorded(vessel: str, identifier: str, *more: str):
    """The trial of a minute of surge-1 or random-1."""
    name, start = ("surge-1", 410) if vessel.startswith("surge") else ("random-1", 100)
    return composed(
        f"vessel={vessel}", "excitation=recording", f"excitation.path={DATA}/beluga/{name}.csv",
        f"excitation.start_s={start}", f"excitation.end_s={start + 60}",
        f"identifier={identifier}", *(f"identifier.{one}" for one in SMALL.get(identifier, [])),
        *more,
    )  # fmt: skip


@pytest.mark.nightly
@pytest.mark.parametrize(("vessel", "identifier"), list(product(FORCED, IDENTIFIERS)))
def test_it_works_or_says_why_not(vessel: str, identifier: str) -> None:
    trial = recorded(vessel, identifier)
    trials.check(trial)
    try:
        results = trials.run(trial)
    except IdentificationError as error:
        said = str(error)
    else:
        said = ""
    if said:
        assert any(words in said for words in REASONS.get(identifier, "none").split("|")), said
        return
    found = [row for row in results.coefficients if row.model == "identified"]
    assert found
    assert all(np.isfinite(row.value) for row in found)
    free_run, limited = (
        [row.value for row in results.metrics if (row.name, row.model) == (name, "identified")]
        for name in ("velocity_rmse_free_run", "limited_share_free_run")
    )
    reasons = [one.label for one in results.diagnostics if one.name == "no_prediction"]
    assert len(free_run) == len(trial.vessel.dofs)
    assert np.all(np.isfinite(free_run)) == (not reasons and limited == [0.0])


@pytest.mark.parametrize(
    ("vessel", "identifier", "option", "message"),
    [
        ("surge_linear", "ls", "force=actual", "force: got actual, but it is not recorded"),
        ("surge_linear", "ls", "lowpass_hz=9", "lowpass_hz must lie between 0 and 5"),
        ("surge_linear", "ls", "basis=[u_dot,v]", "term v has v, but surge_linear moves in surge"),
        ("surge_linear", "output_error", "force=filtered", "force: got filtered, but surge_linear"),
        ("surge_linear", "dsr", "period_s=0.25", "period_s: got 0.25 s, expected a multiple of"),
        ("milliampere", "iv", "wind_measurement=true", "the recorded file has no wind"),
    ],
)
def test_what_cannot_work_is_refused_before_any_work(vessel, identifier, option, message) -> None:
    with pytest.raises(ConfigurationError, match=message):
        trials.check(recorded(vessel, identifier, f"identifier.{option}"))
