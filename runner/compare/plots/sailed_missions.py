"""The sailed missions of one run, for the figures of deployments."""

from collections.abc import Mapping, Sequence

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.plots.request import PlotRequest, each_run
from seatrial.runner.compare.results import Results, Run
from seatrial.runner.compare.statistics import Sample
from seatrial.runner.record.rows import Series

PREFIX = "deployment_"
KINDS = ("deployment_nominal", "deployment_identified")
Voyages = Mapping[str, Series]


def voyages(
    results: Results, request: PlotRequest, what: str, instead: str | None = None
) -> list[tuple[Run, Voyages]]:
    """Return the runs, one for each figure, and their sailed missions by model.

    A run without a deployment uses the series `instead`. `what` names the figure in the error
    message. Of two equal voyages it is the first. Raises ConfigurationError if there is no such
    series or no motion in the plane.
    """
    kinds = KINDS if instead is None else (*KINDS, instead)
    return [
        (
            run,
            distinct(
                _planar_series(results, run, what, [k for k in stored if k in KINDS] or stored)
            ),
        )
        for run, stored in each_run(results, request, kinds)
    ]


def distinct(series_of: Voyages) -> Voyages:
    """Leave out the voyage of the identified model if it is that of the nominal one.

    So it is without identification, and if nothing is taken from the model.
    """
    pair = [series_of.get(name) for name in ("nominal", "identified")]
    if pair[0] is None or pair[1] is None or not _equal(pair[0], pair[1]):
        return series_of
    return {"nominal": pair[0]}


def _equal(first: Series, second: Series) -> bool:
    return first.columns.keys() == second.columns.keys() and all(
        np.array_equal(first.columns[name], second.columns[name], equal_nan=True)
        for name in first.columns
    )


def _planar_series(results: Results, run: Run, what: str, kinds: Sequence[str]) -> Voyages:
    series_of = {kind.removeprefix(PREFIX): results.reader.series(run.id, kind) for kind in kinds}
    for kind, series in zip(kinds, series_of.values(), strict=True):
        missing = [name for name in ("t", "x", "y") if name not in series.columns]
        if missing:
            raise ConfigurationError(
                f"{what}: run {run.id} has no {missing[0]} in its series"
                f" {kind}; it needs a vessel that moves in the plane"
            )
    return series_of


def degrees(values: Sample) -> Sample:
    """Convert radians to degrees."""
    return np.asarray(np.degrees(values), dtype=np.float64)
