"""Descriptive statistics of the columns of a recording: Hoyer (2021), Tables 7.2 to 7.4 and A.4."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.identification.problem import Identified, Identifier, NoIdentifier, Problem

STATISTICS = {
    "count": "count", "mean": "mean", "std": "std", "50%": "median", "min": "minimum",
    "max": "maximum",
}  # fmt: skip


def described(path: str | Path) -> pd.DataFrame:
    """The statistics of each column of a CSV file, whose names are the index; std by n - 1."""
    return pd.read_csv(path).describe([0.5]).T.rename(columns=STATISTICS)


@dataclass(frozen=True)
class Description(Identifier):
    """The nominal model unchanged, with the statistics of the file `path` as diagnostics.

    `statistic_mean` and so on: i is the number of the column, label its name.
    """

    path: str

    def identify(self, problem: Problem, rng: np.random.Generator) -> Identified:
        """The nominal model."""
        rows = [
            Diagnostic(f"statistic_{name}", "all", float(column[name]), i=i, label=str(label))
            for i, (label, column) in enumerate(described(self.path).iterrows())
            for name in STATISTICS.values()
        ]
        same = NoIdentifier().identify(problem, rng)
        return Identified(same.model, same.residual, None, tuple(rows))
