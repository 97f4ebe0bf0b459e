"""The kinds of figures: a file of `plots` each, and what the command line offers."""

from typing import Literal

PlotKind = Literal[
    "bars",
    "orders",
    "residual",
    "track",
    "errors",
    "coefficients",
    "pareto",
    "surface",
    "spectrum",
    "wind",
    "excitation",
    "response",
    "controllers",
    "quality",
    "topology",
    "times",
    "plan",
]
