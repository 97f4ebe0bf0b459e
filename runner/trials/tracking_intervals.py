"""Intervals of the tracking errors after a measured recording.

There the plant of the deployment is the identified model itself, so that its tracking errors are a
prediction. Models and accelerations are drawn from its distribution (`model_error`) as plants under
the same controller, which was built on the identified model, in the same weather. The deviations
are drawn at their whole size: a loop that holds the vessel near its reference bounds them, and what
an acceleration adds to a mean absolute error is not proportional to it.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError, Diverged
from seatrial.models.excitation.missions import Mission
from seatrial.models.identification.calibration import squared_accelerations
from seatrial.models.identification.problem import Identified
from seatrial.models.recording.recording import attitude_of
from seatrial.runner.configuration.config import Trial
from seatrial.runner.record.rows import Metric
from seatrial.runner.trials.closed_loop import SimulatedMission, Streams, prepare, wind_in_body
from seatrial.runner.trials.deployment_metrics import tracking_metrics

LOW, HIGH = "tracking_low", "tracking_high"  # diagnostics: a 90 % interval of a tracking error
QUANTILES = (0.05, 0.95)
TRACKING_DRAWS = 40
ERRORS = ("e_pos_mae", "e_psi_mae")


def tracking_intervals(
    trial: Trial, seeds: Streams, identified: Identified, mission: Mission, own: SimulatedMission
) -> list[Diagnostic]:
    """Return the bounds of the errors of `own`, the deployment of the identified model.

    Empty without a distribution. A controller that plans ahead takes too long for draws: it has
    the diagnostic `no_tracking_interval`, as has one whose drawn plants diverge.
    """
    if identified.spread is None:
        return []
    if own.design.ahead:
        return [_refused("the controller plans ahead, which takes too long for drawn plants")]
    values: dict[tuple[str, str, str], list[float]] = {}
    for row in _drawn(trial, seeds, identified, mission, own):
        if row.name in ERRORS and row.value is not None:
            values.setdefault((row.name, row.dof, row.unit), []).append(row.value)
    if any(len(each) < 0.9 * TRACKING_DRAWS for each in values.values()) or not values:
        return [_refused("more than a tenth of the drawn plants diverge")]
    return [
        Diagnostic(name, dof, float(bound), unit, label=error)
        for (error, dof, unit), each in values.items()
        for name, bound in zip((LOW, HIGH), np.quantile(each, QUANTILES), strict=True)
    ]


def _refused(reason: str) -> Diagnostic:
    return Diagnostic("no_tracking_interval", "all", 1.0, label=reason)


def _drawn(
    trial: Trial, seeds: Streams, identified: Identified, mission: Mission, own: SimulatedMission
) -> Iterator[Metric]:
    """Return the tracking metrics of every drawn plant."""
    log, error = own.voyage.log, identified.model_error
    attitude = attitude_of(own.voyage.dofs, log.eta)
    wind = wind_in_body(own.voyage)
    rho2 = squared_accelerations(identified.model, log.nu, attitude, log.tau_actual, wind)
    for i, plant in enumerate(identified.draws(TRACKING_DRAWS)):
        try:
            prepared = prepare(trial, seeds, identified.model, mission, deployed=True, true=plant)
            if error is not None:
                drawn = error.accelerations(rho2, own.period_s, np.random.default_rng(i))
                process = prepared.weather.process
                weather = prepared.weather._replace(
                    process=drawn + process if len(process) else drawn
                )
                prepared = replace(prepared, weather=weather)
            yield from tracking_metrics(prepared.sail().voyage, "identified", own.period_s)
        except (ConfigurationError, Diverged):
            continue
