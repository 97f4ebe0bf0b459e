"""What a run is identified from: what is commanded, its spectrum, the wind, and singular values.

There is a row of panels for each force by degree of freedom, or for each input by name: over time
with the limits, and its spectrum. Rows below show the wind, and of a subspace identification the
singular values of the data. Vessels by force have columns
`tau_surge`, ..., steered vessels the inputs of their configuration, such as `delta` and `n`, with
`delta_command` where the command is recorded too.

Diagnostics: `regressor_rank`, `regressor_unknowns`, `spectral_lines`, and `inseparable_terms`
with the names in `label`; `singular_value` (i = number, from 1), `selected_order`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.figures import Figure
from seatrial.runner.compare.frame import Queries, StoredRun
from seatrial.runner.compare.grid import number_text, unit_text, with_unit
from seatrial.runner.compare.plots import style
from seatrial.runner.compare.plots.request import PlotRequest, diagnostics_of, each_run, subtitle
from seatrial.runner.compare.plots.style import Drawing
from seatrial.runner.compare.statistics import Sample
from seatrial.runner.record.rows import Series
from seatrial.runner.record.vocabulary import DOFS, Config

FIGURE = Figure(
    "excitation",
    "Forces or inputs of one run, their spectrum and the limits; its wind; singular values.",
    "series recording",
    ("run", "dof", "facet"),
    caption="Excitation of the newest run and its spectrum",
    place=13,
)

# Units of inputs by the beginning of their names, and the size of the unit.
INPUT_UNITS = {
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
ZERO_DEVIATION = 1e-9  # of the mean, a deviation that is none
NARROWEST_DEG = 10.0  # smallest half-range of the direction
SMALL: dict[str, Any] = {"loc": "left", "fontsize": 8.5, "fontweight": "normal"}  # titles of panels


@dataclass(frozen=True, eq=False)
class CommandedSignal:
    """A commanded signal over time, shape (n,), in the unit of its axis; an input has no `dof`."""

    name: str
    commanded: Sample
    acting: Sample | None
    unit: str
    limits: tuple[float, float] | None
    dof: str = ""


def commanded_signals(
    series_of: Sequence[Series], config: Config, dofs: Sequence[str]
) -> list[list[CommandedSignal]]:
    """Return for each series its forces in these degrees of freedom, or else its inputs.

    What acts is left out where it is what is commanded, or was in the sample before.
    """
    first, vessel = series_of[0], config.get("vessel") or {}
    limits = dict(zip(vessel.get("dofs") or (), vessel.get("force_limits") or (), strict=False))
    rows: list[tuple[str, str, str, str, float, list[float | None], str]] = []
    for dof in dofs:
        name, end = f"tau_{dof}", limits.get(dof)
        if name in first.columns:
            largest = style.largest_of([series.columns[name] for series in series_of])
            ends = [end and -end, end]
            unit = style.prefixed(first.units[name], largest)
            rows.append((dof.capitalize(), name, f"tau_actual_{dof}", *unit, ends, dof))
    for name, options in (vessel.get("inputs") or {}).items() if not rows else ():
        if name in first.columns:
            unit = INPUT_UNITS.get(name.split("_")[0], ("-", 1.0))
            ends = [options.get(end) for end in ("low", "high")]
            rows.append((name, f"{name}_command", name, *unit, ends, ""))
    signals_of = []
    for columns in (series.columns for series in series_of):
        signals_of.append(signals := list[CommandedSignal]())
        for name, command, actual, own_unit, size, ends, dof in rows:
            acting = columns.get(actual)
            force = columns[command] if command in columns else columns[actual]
            if acting is not None:
                late = np.allclose(acting[1:], force[:-1]) or np.allclose(acting, force)
                acting = None if late else acting / size
            low, high = ends
            own = None if low is None or high is None else (low / size, high / size)
            signals.append(CommandedSignal(name, force / size, acting, own_unit, own, dof))
    return signals_of


def drawings(results: Queries, request: PlotRequest) -> list[Drawing]:
    """Draw one figure of one run (with --facet, for each level), one row for each signal."""
    return [
        _drawing(results, request, run, series_of["recording"])
        for run, series_of in each_run(results, request, ("recording",))
    ]


def _drawing(results: Queries, request: PlotRequest, run: StoredRun, series: Series) -> Drawing:
    dofs = request.shown(lambda dof: f"tau_{dof}" in series.columns) or list(request.dofs)
    (signals,) = commanded_signals([series], results.reader.run(run.id).config, dofs)
    excited = [s for s in signals if np.any(s.commanded if s.dof else np.diff(s.commanded))]
    excited = excited or [signal for signal in signals if np.any(signal.commanded)]
    if not excited:
        raise ConfigurationError(f"plot excitation: run {run.id} has no force in these DOFs")
    diagnostics = diagnostics_of(results, run, (*REPORT, INSEPARABLE_TERMS, SINGULAR, ORDER))
    subspace = (diagnostics["name"] == SINGULAR).any()
    blown = request.shown(lambda dof: f"wind_{dof}" in series.columns)
    winds = 0 if NORTH not in series.columns else 2 if blown else 1
    rows = len(excited) + winds + subspace
    figure, axes = style.panels(rows, 2, 5.4, 2.3 if rows > 1 else 3.2)
    for left, right, signal in zip(axes[::2], axes[1::2], excited, strict=False):
        _over_time(left, series, signal)
        _spectrum(right, series, signal, diagnostics)
    last = 2 * len(excited)
    axes[last - 1].set_xlabel("Frequency [Hz]")
    axes[last + 2 * winds - 2].set_xlabel(with_unit("Time", series.units["t"]))
    if winds:
        _wind(axes[last : last + 2 * winds], series, blown)
    if subspace:
        _singular_values(axes[-2], diagnostics)
        axes[-1].remove()
    notes = ["shaded: training part"] if np.any(series.columns.get("train", np.zeros(1))) else []
    idle = [signal for signal in signals if signal not in excited]
    if idle and all(signal.dof and not np.any(signal.commanded) for signal in idle):
        notes.append(f"no force in {', '.join(signal.dof for signal in idle)}")
    elif idle:
        levels = [f"{s.name} {_amount(s.commanded[0], s.unit)}" for s in idle]
        notes.append(f"constant: {', '.join(levels)}")
    notes.append("spectra: up to twice the last frequency with a tenth of the highest amplitude")
    notes += ["wind: means and deviations at the right, direction from north over east"] * (
        winds > 0
    )
    alike = diagnostics[(diagnostics["name"] == INSEPARABLE_TERMS) & diagnostics["dof"].isin(dofs)]
    for dof, own in alike.groupby("dof", sort=False):
        terms = "; ".join(" ~ ".join(label.split()) for label in own["label"])
        notes.append(f"{dof}, not separable: {terms}")
    name, title = f"excitation-run-{run.id}", f"Excitation, {subtitle(run)}"
    return style.drawing_of(name, figure, figure.axes, title, notes)


def _amount(value: float, unit: str) -> str:
    return f"{number_text(float(value), 3)} {unit_text(unit)}"


def _over_time(axes: Axes, series: Series, signal: CommandedSignal) -> None:
    """Draw what is commanded and acts, with the limits and how much of them is used."""
    t, peak = series.columns["t"], style.largest_of([signal.commanded])
    axes.plot(t, signal.commanded, color=FORCE, linewidth=1.0, label="commanded")
    if signal.acting is not None:
        axes.plot(t, signal.acting, color=ACTING, linewidth=1.0, label="acting")
    title = f"peak {_amount(peak, signal.unit)}"
    if signal.limits is not None:
        largest = max(map(abs, signal.limits))
        title += f", {peak / largest:.0%} of the limit"
        if largest <= style.SHOWN_LIMIT * peak:
            style.draw_limits(axes, signal.limits, peak, unit_text(signal.unit))
    style.shaded(axes, t, np.asarray(series.columns.get("train", np.zeros(0)), dtype=np.float64))
    axes.set_title(title, **SMALL)
    axes.set_ylabel(with_unit(signal.name, signal.unit))
    axes.margins(x=0)


def _spectrum(
    axes: Axes, series: Series, signal: CommandedSignal, diagnostics: pd.DataFrame
) -> None:
    """Draw the amplitudes of a uniformly sampled signal, and what can be separated by it."""
    t, force = series.columns["t"], signal.commanded
    period = float(t[-1] - t[0]) / (len(t) - 1)
    size = 2.0 * np.abs(np.fft.rfft(force - np.mean(force)))[1:] / len(force)
    frequency = np.fft.rfftfreq(len(force), period)[1:]
    axes.set_xscale("log")
    axes.set_ylabel(with_unit("Amplitude", signal.unit))
    largest = float(np.max(size))
    axes.set_xlim(frequency[0], frequency[-1])
    if largest > 0.0:
        width = max(5, len(size) // 100)  # a mean over neighbours evens out noise
        smooth = np.sqrt(np.convolve(np.square(size), np.ones(width) / width, "same"))
        last = float(frequency[np.flatnonzero(smooth >= MATTERS * np.max(smooth))[-1]])
        shown = frequency <= max(2.0 * last, 10.0 * frequency[0])
        axes.set_yscale("log")
        axes.plot(frequency, size, color=FORCE, linewidth=0.8)
        axes.set_xlim(frequency[0], frequency[shown][-1])
        axes.set_ylim(max(DEPTH * largest, 0.5 * float(np.min(size[shown]))), 2.0 * largest)
    own = diagnostics[(diagnostics["dof"] == signal.dof) & diagnostics["name"].isin(REPORT)]
    if len(own) == len(REPORT):
        rank, unknowns, lines = own.set_index("name")["value"].astype(int)[[*REPORT]]
        axes.set_title(f"spectral lines: {lines}; {rank} of {unknowns} terms separable", **SMALL)


def _wind(axes: Sequence[Axes], series: Series, dofs: Sequence[str]) -> None:
    """Draw speed and direction of the wind, and below them its forces and its moments."""
    north, east, t = (series.columns[name] for name in (NORTH, EAST, "t"))
    direction = blown_to(north, east)
    shown = [
        ("Wind speed", "m/s", {"": np.hypot(north, east)}),
        ("Blows to", "deg", {"": direction}),
    ]
    for what, si in (("Wind force", "N"), ("Wind moment", "Nm")):
        own = {d: series.columns[f"wind_{d}"] for d in dofs if series.units[f"wind_{d}"] == si}
        unit, size = style.prefixed(si, style.largest_of([*own.values()]))
        shown.append((what, unit, {dof: force / size for dof, force in own.items()}))
    for panel, (name, unit, signals) in zip(axes, shown, strict=False):
        if not signals:
            panel.remove()
            continue
        texts = []
        for dof, values in signals.items():
            colour = style.PALETTE[2 + DOFS.index(dof)] if dof else style.WIND
            label = f"wind, {dof}" if dof else None
            panel.plot(t, values, color=colour, linewidth=1.0, label=label)
            texts.append(_statistics(values, unit, colour))
        low, high = panel.get_ylim()
        if unit == "deg":
            panel.set_ylim(
                min(low, texts[0][0] - NARROWEST_DEG), max(high, texts[0][0] + NARROWEST_DEG)
            )
        else:
            panel.set_ylim(min(low, 0.0), max(high, 0.0))
        style.beside(panel, texts)
        panel.set_ylabel(with_unit(name, unit))
        panel.set_xlabel(with_unit("Time", series.units["t"]) if panel is axes[-1] else "")
        panel.margins(x=0)


def blown_to(north: Sample, east: Sample) -> Sample:
    """Return the direction that the wind blows to [deg], shape (n,), its mean in [0, 360).

    `north` and `east` are the wind velocities [m/s], shape (n,). The direction is unwrapped, and
    NaN for calm air.
    """
    angle = np.degrees(np.unwrap(np.arctan2(east, north)))
    angle -= 360.0 * np.floor(np.mean(angle) / 360.0)
    return np.where(np.hypot(north, east) > CALM_M_S, angle, np.nan)


def _statistics(values: Sample, unit: str, colour: str) -> tuple[float, str, str]:
    """Return the mean of a signal, and the text on it for the side of its panel."""
    finite = values[np.isfinite(values)]
    if not len(finite):
        return 0.0, "", colour
    mean, deviation = float(np.mean(finite)), float(np.std(finite))
    deviation = 0.0 if deviation < ZERO_DEVIATION * abs(mean) else deviation
    return mean, f"{number_text(mean, 3)} ± {_amount(deviation, unit)}", colour


def _singular_values(axes: Axes, diagnostics: pd.DataFrame) -> None:
    """Draw the singular values of the data, filled within the selected order."""
    rows = diagnostics[diagnostics["name"] == SINGULAR].dropna(subset="value").sort_values("i")
    axes.plot(rows["i"], rows["value"], "o-", color=FORCE, fillstyle="none")
    order = diagnostics.loc[diagnostics["name"] == ORDER, "value"].max()
    if order > 0:
        within = rows[rows["i"] <= order]
        axes.plot(within["i"], within["value"], "o", color=FORCE)
        axes.set_title(f"filled: the selected order {order:g}", **SMALL)
    axes.set_yscale("log")
    axes.set_xlabel("Number")
    axes.set_ylabel(with_unit("Singular value", rows["unit"].iloc[0]))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
