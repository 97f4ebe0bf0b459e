"""The sailed missions of one run: what the figures over them share."""

from collections.abc import Mapping

import numpy as np

from models.errors import ConfigurationError
from runner.database.records import Series

from ..observations import Run
from ..results import Results
from ..statistics import Sample
from .request import PlotRequest, one_run

PREFIX = "deployment_"
KINDS = ("deployment_nominal", "deployment_identified")


def voyages(results: Results, request: PlotRequest, what: str) -> tuple[Run, Mapping[str, Series]]:
    """The run and its sailed missions by model; ConfigurationError where it has none."""
    run, kinds = one_run(results, request, KINDS)
    found = {kind.removeprefix(PREFIX): results.reader.series(run.id, kind) for kind in kinds}
    for model, series in found.items():
        missing = [name for name in ("t", "x", "y") if name not in series.columns]
        if missing:
            raise ConfigurationError(
                f"plot {what}: run {run.id} has no {missing[0]} in its series"
                f" {PREFIX}{model}; it needs a vessel that moves in the plane"
            )
    return run, found


def degrees(values: Sample) -> Sample:
    """Radians as degrees."""
    return np.asarray(np.degrees(values), dtype=np.float64)
