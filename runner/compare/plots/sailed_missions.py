"""The sailed missions of one run: what the figures over them share."""

from collections.abc import Mapping, Sequence

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.plots.request import PlotRequest, each_run
from seatrial.runner.compare.results import Results, Run
from seatrial.runner.compare.statistics import Sample
from seatrial.runner.database.records import Series

PREFIX = "deployment_"
KINDS = ("deployment_nominal", "deployment_identified")
Voyages = Mapping[str, Series]


def voyages(
    results: Results, request: PlotRequest, what: str, instead: str | None = None
) -> list[tuple[Run, Voyages]]:
    """The runs, one a figure, and their sailed missions by model.

    Of a run without a deployment the series `instead` is taken. Raises ConfigurationError where
    there is none, or no motion in the plane.
    """
    kinds = KINDS if instead is None else (*KINDS, instead)
    return [
        (run, _in_the_plane(results, run, what, [k for k in have if k in KINDS] or have))
        for run, have in each_run(results, request, kinds)
    ]


def _in_the_plane(results: Results, run: Run, what: str, kinds: Sequence[str]) -> Voyages:
    found = {kind.removeprefix(PREFIX): results.reader.series(run.id, kind) for kind in kinds}
    for kind, series in zip(kinds, found.values(), strict=True):
        missing = [name for name in ("t", "x", "y") if name not in series.columns]
        if missing:
            raise ConfigurationError(
                f"plot {what}: run {run.id} has no {missing[0]} in its series"
                f" {kind}; it needs a vessel that moves in the plane"
            )
    return found


def degrees(values: Sample) -> Sample:
    """Radians as degrees."""
    return np.asarray(np.degrees(values), dtype=np.float64)
