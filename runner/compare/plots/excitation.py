"""What a run is identified from: what is commanded, its spectrum, the wind, and singular values.

There is a row of panels for each force (`tau_surge`, ...), or for each input of a steered vessel
(`delta`, with `delta_command` where it is recorded): over time with the limits, and its spectrum.
Rows below show the wind, and of a subspace identification the singular values of the data.

Diagnostics: `regressor_rank`, `regressor_unknowns`, `spectral_lines`, and `inseparable_terms`
with the names in `label`; `singular_value` (i = number, from 1), `selected_order`.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.figures import Figure, PlotRequest
from seatrial.runner.compare.frame import Queries, StoredRun
from seatrial.runner.compare.grid import number_text, unit_text, with_unit
from seatrial.runner.compare.plots import selection, style
from seatrial.runner.compare.statistics import Sample
from seatrial.runner.compare.where import Condition
from seatrial.runner.record.rows import Series
from seatrial.runner.record.vocabulary import DOFS, Config

FIGURE = Figure(
    "excitation",
    "Forces or inputs of one run, their spectrum and the limits; its wind; singular values.",
    "series recording", ("run", "dof", "facet"), place=13,
)  # fmt: skip

INPUT_UNITS = {  # by the beginning of their names, and the size of the unit
    **dict.fromkeys(("delta", "alpha"), ("deg", float(np.radians(1.0)))),
    **dict.fromkeys(("n",), ("1/s", 1.0)),
}
REPORT = ("regressor_rank", "regressor_unknowns", "spectral_lines")
INSEPARABLE_TERMS = "inseparable_terms"
SINGULAR, ORDER = "singular_value", "selected_order"
MATTERS = 0.1  # smallest amplitude that matters, relative to the largest, both smoothed
DEPTH = 1e-3  # smallest amplitude shown, likewise
FORCE, ACTING = style.PALETTE[0], style.PALETTE[1]
NORTH, EAST = "wind_north", "wind_east"
CALM_M_S = 1e-6  # below it wind has no direction
SMALL: dict[str, Any] = {"loc": "left", "fontsize": 8.5, "fontweight": "normal"}  # titles of panels


class CommandedSignal(NamedTuple):
    """A commanded signal over time, shape (n,), in the unit of its axis; an input has no `dof`."""

    name: str
    commanded: Sample
    acting: Sample | None
    unit: str
    limits: tuple[float, float] | None
    dof: str

    @property
    def peak(self) -> float:
        """The largest absolute value."""
        return style.largest_of([self.commanded])

    @property
    def moves(self) -> bool:
        """Whether it excites: a force that acts, an input that changes."""
        return bool(np.any(self.commanded if self.dof else np.diff(self.commanded)))


def commanded_signals(
    series_of: Sequence[Series], config: Config, dofs: Sequence[str]
) -> list[list[CommandedSignal]]:
    """Return the forces in these degrees of freedom, or else the inputs, each in every series.

    What acts is left out where it is what is commanded, or was in the sample before.
    """
    first, vessel, signals = series_of[0], config.get("vessel") or {}, []
    limits = dict(zip(vessel.get("dofs") or (), vessel.get("force_limits") or (), strict=False))
    inputs = {n: ends for n, ends in (vessel.get("inputs") or {}).items() if n in first.columns}
    forces = [dof for dof in dofs if f"tau_{dof}" in first.columns]
    for name in forces or inputs:
        if name in forces:
            largest = style.largest_of([series.columns[f"tau_{name}"] for series in series_of])
            unit, size = style.prefixed(first.units[f"tau_{name}"], largest)
            high = limits.get(name)
            low = high and -high
            names = name.capitalize(), f"tau_{name}", f"tau_actual_{name}", name
        else:
            unit, size = INPUT_UNITS.get(name.split("_")[0], ("-", 1.0))
            low, high = (inputs[name].get(end) for end in ("low", "high"))
            names = name, f"{name}_command", name, ""
        own = None if low is None or high is None else (low / size, high / size)
        label, command, actual, dof = names
        signals.append(list[CommandedSignal]())
        for columns in (series.columns for series in series_of):
            acting = columns.get(actual)
            force = columns[command if command in columns else actual]
            if acting is not None:
                late = np.allclose(acting[1:], force[:-1]) or np.allclose(acting, force)
                acting = None if late else acting / size
            signals[-1].append(CommandedSignal(label, force / size, acting, unit, own, dof))
    return signals


def _drawing(
    results: Queries, request: PlotRequest, run: StoredRun, series_of: Mapping[str, Series]
) -> style.Drawing:
    """Draw one row for each signal."""
    series = series_of["recording"]
    dofs = request.shown(lambda dof: f"tau_{dof}" in series.columns) or [*(request.dof or ())]
    config = results.reader.run(run.id).config
    signals = [own[0] for own in commanded_signals([series], config, dofs)]
    excited = [s for s in signals if s.moves] or [s for s in signals if s.peak]
    if not excited:
        raise ConfigurationError(f"plot excitation: run {run.id} has no force in these DOFs")
    names, of_run = (*REPORT, INSEPARABLE_TERMS, SINGULAR, ORDER), Condition(runs=(run.id,))
    diagnostics = results.diagnostics(names, of_run)
    subspace = diagnostics[diagnostics["name"] == SINGULAR].dropna(subset="value")
    wind = _wind(series, request.shown(lambda dof: f"wind_{dof}" in series.columns))
    shown = 2 * len(excited) + len(wind) + (len(subspace) > 0)
    figure, axes = style.panels(-(-shown // 2), 2, 5.4, 2.3 if shown > 2 else 3.2, count=shown)
    panels = iter(axes)
    for signal in excited:
        _over_time(next(panels), series, signal)
        _spectrum(next(panels), series, signal, diagnostics)
    for label, curves in wind:
        style.over_time(next(panels), label, curves, linewidth=1.0)
    if len(subspace):
        order = diagnostics.loc[diagnostics["name"] == ORDER, "value"].max()
        panel, subspace = next(panels), subspace.sort_values("i")
        panel.plot(subspace["i"], subspace["value"], "o-", color=FORCE, fillstyle="none")
        if order > 0:  # NaN: none is selected
            within = subspace[subspace["i"] <= order]
            panel.plot(within["i"], within["value"], "o", color=FORCE)
            panel.set_title(f"filled: the selected order {order:g}", **SMALL)
        label = with_unit("Singular value", subspace["unit"].iloc[0])
        panel.set(yscale="log", xlabel="Number", ylabel=label)
        panel.xaxis.set_major_locator(MaxNLocator(integer=True))
    notes = ["shaded: training part"] if np.any(series.columns.get("train", 0.0)) else []
    idle = [
        f"constant: {s.name} {_amount(float(s.commanded[0]), s.unit)}" if s.peak or not s.dof
        else f"no force in {s.dof}" for s in signals if s not in excited
    ]  # fmt: skip
    notes += ["; ".join(idle)] if idle else []
    notes.append("spectra: up to twice the last frequency with a tenth of the highest amplitude")
    notes += ["wind: means at the right, direction from north over east"] * bool(wind)
    alike = diagnostics[(diagnostics["name"] == INSEPARABLE_TERMS) & diagnostics["dof"].isin(dofs)]
    for dof, own in alike.groupby("dof", sort=False):
        terms = "; ".join(" ~ ".join(label.split()) for label in own["label"])
        notes.append(f"{dof}, not separable: {terms}")
    name, title = f"excitation-run-{run.id}", f"Excitation, {selection.subtitle(run)}"
    return style.drawing_of(name, figure, axes, title, notes)


def _amount(value: float, unit: str) -> str:
    return f"{number_text(value, 3)} {unit_text(unit)}"


def _over_time(axes: Axes, series: Series, signal: CommandedSignal) -> None:
    """Draw what is commanded and acts, with the limits and how much of them is used."""
    t, title = series.columns["t"], f"peak {_amount(signal.peak, signal.unit)}"
    curves = [style.Curve(t, signal.commanded, FORCE, "commanded")]
    if signal.acting is not None:
        curves.append(style.Curve(t, signal.acting, ACTING, "acting"))
    if signal.limits is not None:
        title += f", {signal.peak / max(map(abs, signal.limits)):.0%} of the limit"
    style.draw_limits(axes, signal.limits, signal.peak)
    style.shaded(axes, series.columns)
    axes.set_title(title, **SMALL)
    style.over_time(axes, with_unit(signal.name, signal.unit), curves, linewidth=1.0)


def _spectrum(
    axes: Axes, series: Series, signal: CommandedSignal, diagnostics: pd.DataFrame
) -> None:
    """Draw the amplitudes of a uniformly sampled signal, and what can be separated by it."""
    t, force = series.columns["t"], signal.commanded
    period = float(t[-1] - t[0]) / (len(t) - 1)
    size = 2.0 * np.abs(np.fft.rfft(force - np.mean(force)))[1:] / len(force)
    frequency = np.fft.rfftfreq(len(force), period)[1:]
    axes.set(xscale="log", xlabel="Frequency [Hz]", ylabel=with_unit("Amplitude", signal.unit))
    largest = float(np.max(size))
    if largest > 0.0:
        width = max(5, len(size) // 100)  # a mean over neighbours evens out noise
        smooth = np.sqrt(np.convolve(np.square(size), np.ones(width) / width, "same"))
        last = float(frequency[np.flatnonzero(smooth >= MATTERS * np.max(smooth))[-1]])
        shown = frequency <= max(2.0 * last, 10.0 * frequency[0])
        axes.plot(frequency, size, color=FORCE, linewidth=0.8)
        lowest = max(DEPTH * largest, 0.5 * float(np.min(size[shown])))
        axes.set(yscale="log", ylim=(lowest, 2.0 * largest))
        axes.set_xlim(frequency[0], frequency[shown][-1])
    own = diagnostics[(diagnostics["dof"] == signal.dof) & diagnostics["name"].isin(REPORT)]
    if len(own) == len(REPORT):
        rank, unknowns, lines = own.set_index("name")["value"].astype(int)[[*REPORT]]
        axes.set_title(f"spectral lines: {lines}; {rank} of {unknowns} terms separable", **SMALL)


def _wind(series: Series, dofs: Sequence[str]) -> list[tuple[str, list[style.Curve]]]:
    """Return the panels of the wind: its speed and direction, its forces and its moments."""
    columns, panels = series.columns, []
    if NORTH not in columns:
        return []
    north, east = columns[NORTH], columns[EAST]
    speed, angle = np.hypot(north, east), np.degrees(np.unwrap(np.arctan2(east, north)))
    angle -= 360.0 * np.floor(np.mean(angle) / 360.0)  # its mean is in [0, 360)
    blows = np.where(speed > CALM_M_S, angle, np.nan)
    signals = [("Wind speed", "m/s", {"": speed}), ("Blows to", "deg", {"": blows})]
    for what, si in (("Wind force", "N"), ("Wind moment", "Nm")):
        own = {dof: columns[f"wind_{dof}"] for dof in dofs if series.units[f"wind_{dof}"] == si}
        unit, size = style.prefixed(si, style.largest_of([*own.values()]))
        signals += [(what, unit, {dof: force / size for dof, force in own.items()})] if own else []
    for what, unit, of_panel in signals:
        curves = []
        for dof, values in of_panel.items():
            colour = style.PALETTE[2 + DOFS.index(dof)] if dof else style.WIND
            finite = values[np.isfinite(values)]
            mean = _amount(float(np.mean(finite)), unit) if len(finite) else ""
            words = f"wind, {dof}" if dof else "", mean
            curves.append(style.Curve(columns["t"], values, colour, *words))
        panels.append((with_unit(what, unit), curves))
    return panels


drawings = selection.per_run(_drawing, "recording")
