"""Response of a steered vessel over time: its heading, and every input with its limits."""

from collections.abc import Mapping, Sequence

import matplotlib.figure
import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.grid import with_unit
from seatrial.runner.compare.plots.commanded_signals import commanded_signals
from seatrial.runner.compare.plots.force_units import NEAR, largest_of
from seatrial.runner.compare.plots.sailed_missions import degrees
from seatrial.runner.compare.plots.style import REFERENCE, panels
from seatrial.runner.database.records import Series
from seatrial.runner.vocabulary import Config

NOTE = "inputs as commanded; dashed: reference"


def is_steered(series: Series) -> bool:
    """Return whether a voyage is commanded by inputs, and has a heading."""
    return "psi" in series.columns and not any(n.startswith("tau_") for n in series.columns)


def steered(
    lines: Mapping[str, Series],
    config: Config,
    colours: Sequence[str],
    dofs: Sequence[str],
    what: str,
) -> matplotlib.figure.Figure:
    """Draw heading and inputs of missions in the same axes; `lines` are the series by label.

    `dofs` are those requested; the figure is the one of yaw. `what` names it in the error message.
    """
    if dofs and "yaw" not in dofs:
        raise ConfigurationError(f"plot: {what} has no response of these degrees of freedom")
    first = next(iter(lines.values()))
    shown = {label: commanded_signals(series, config, ()) for label, series in lines.items()}
    signals = next(iter(shown.values()))
    figure, axes = panels(1 + len(signals), 1, 8.0, 2.3, share_x=True)
    heading, *inputs = axes
    if "psi_d" in first.columns:
        reference = degrees(np.unwrap(first.columns["psi_d"]))
        heading.plot(first.columns["t"], reference, "--", color=REFERENCE, label="reference")
    for (label, series), colour in zip(lines.items(), colours, strict=True):
        t = series.columns["t"]
        heading.plot(t, degrees(np.unwrap(series.columns["psi"])), color=colour, label=label)
        for panel, signal in zip(inputs, shown[label], strict=True):
            panel.plot(t, signal.commanded, color=colour, linewidth=1.1)
    heading.set_ylabel("Heading [deg]")
    for i, (panel, signal) in enumerate(zip(inputs, signals, strict=True)):
        panel.set_ylabel(with_unit(signal.name, signal.unit))
        peak = largest_of([those[i].commanded for those in shown.values()])
        if signal.limits is not None and max(map(abs, signal.limits)) <= NEAR * peak:
            for side in signal.limits:
                panel.axhline(side, color=REFERENCE, linestyle="-.", linewidth=0.9, label="limit")
    axes[-1].set_xlabel(with_unit("Time", first.units["t"]))
    for panel in axes:
        panel.margins(x=0)
    return figure
