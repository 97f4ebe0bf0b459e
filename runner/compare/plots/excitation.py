"""What a run is identified from: what is commanded, its spectrum, the wind, and singular values.

There is a row of panels for each force by degree of freedom, or for each input by name: over time
with the limits, and its spectrum. Rows below show the wind, and of a subspace identification the
singular values of the data with the eigenvalues of the model. Vessels by force have columns
`tau_surge`, ..., steered vessels the inputs of their configuration, such as `delta` and `n`, with
`delta_command` where the command is recorded too.

Diagnostics: `regressor_rank`, `regressor_unknowns`, `spectral_lines`, and `inseparable_terms`
with the names in `label`; `singular_value` (i = number, from 1), `selected_order`, and
`eigenvalue_real`, `eigenvalue_imag` (i = number), discrete time, of the identified model.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle
from matplotlib.ticker import MaxNLocator

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.figures import Figure
from seatrial.runner.compare.frame import Queries, StoredDiagnostic, StoredRun
from seatrial.runner.compare.grid import number_text, unit_text, with_unit
from seatrial.runner.compare.plots.request import PlotRequest, diagnostics_of, each_run, subtitle
from seatrial.runner.compare.plots.style import (
    MUTED,
    PALETTE,
    REFERENCE,
    SHOWN_LIMIT,
    WIND,
    Drawing,
    beside,
    drawing_of,
    largest_of,
    limits_of,
    panels,
    prefixed,
    shaded,
)
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
GROUPS = "inseparable_terms"
SINGULAR, ORDER = "singular_value", "selected_order"
REAL, IMAGINARY = "eigenvalue_real", "eigenvalue_imag"
MATTERS = 0.1  # smallest amplitude that matters, relative to the largest, both smoothed
DEPTH = 1e-3  # smallest amplitude shown, likewise
FORCE, ACTING = PALETTE[0], PALETTE[1]
NORTH, EAST = "wind_north", "wind_east"
CALM_M_S = 1e-6  # below it wind has no direction
ROUNDING = 1e-9  # of the mean, a deviation that is none
NARROWEST_DEG = 10.0  # smallest half-range of the direction


@dataclass(frozen=True, eq=False)
class CommandedSignal:
    """A commanded signal over time, shape (n,), in the unit of its axis.

    `dof` is its degree of freedom, empty for an input; `size` is the size of the unit in SI units.
    """

    name: str
    commanded: Sample
    acting: Sample | None
    unit: str
    size: float
    limits: tuple[float, float] | None
    dof: str = ""


def commanded_signals(series: Series, config: Config, dofs: Sequence[str]) -> list[CommandedSignal]:
    """Return the forces of a series in these degrees of freedom, or else its inputs."""
    forces = [dof for dof in dofs if f"tau_{dof}" in series.columns]
    if forces:
        limits = limits_of(config)
        return [_force(series, dof, limits.get(dof)) for dof in forces]
    inputs = (config.get("vessel") or {}).get("inputs") or {}
    return [_input(series, name, inputs[name]) for name in inputs if name in series.columns]


def _force(series: Series, dof: str, limit: float | None) -> CommandedSignal:
    force, acting = series.columns[f"tau_{dof}"], series.columns.get(f"tau_actual_{dof}")
    unit, size = prefixed(series.units[f"tau_{dof}"], largest_of([force]))
    if acting is not None and np.allclose(acting[1:], force[:-1]):
        acting = None
    return CommandedSignal(
        dof.capitalize(), force / size, None if acting is None else acting / size, unit, size,
        None if limit is None else (-limit / size, limit / size), dof,
    )  # fmt: skip


def _input(series: Series, name: str, options: Config) -> CommandedSignal:
    command, measured = series.columns.get(f"{name}_command"), series.columns[name]
    unit, size = INPUT_UNITS.get(name.split("_")[0], ("-", 1.0))
    low, high = options.get("low"), options.get("high")
    return CommandedSignal(
        name, (measured if command is None else command) / size,
        None if command is None or np.allclose(command, measured) else measured / size, unit, size,
        None if low is None or high is None else (low / size, high / size),
    )  # fmt: skip


def drawings(results: Queries, request: PlotRequest) -> list[Drawing]:
    """Draw one figure of one run (with --facet, for each level), one row for each signal."""
    return [
        _drawing(results, request, run, series_of["recording"])
        for run, series_of in each_run(results, request, ("recording",))
    ]


def _drawing(results: Queries, request: PlotRequest, run: StoredRun, series: Series) -> Drawing:
    dofs = request.shown(lambda dof: f"tau_{dof}" in series.columns) or list(request.dofs)
    signals = commanded_signals(series, results.reader.run(run.id).config, dofs)
    excited = [s for s in signals if np.any(s.commanded if s.dof else np.diff(s.commanded))]
    excited = excited or [signal for signal in signals if np.any(signal.commanded)]
    idle = [signal for signal in signals if signal not in excited]
    blown = request.shown(lambda dof: f"wind_{dof}" in series.columns)
    if not excited:
        raise ConfigurationError(f"plot excitation: run {run.id} has no force in these DOFs")
    names = (*REPORT, GROUPS, SINGULAR, ORDER, REAL, IMAGINARY)
    diagnostics = diagnostics_of(results, run, names)
    subspace = any(row.name in (SINGULAR, REAL) for row in diagnostics)
    winds = 0 if NORTH not in series.columns else 2 if blown else 1
    rows = len(excited) + winds + subspace
    figure, axes = panels(rows, 2, 5.4, 2.3 if len(excited) > 1 or rows > 1 else 3.2)
    for left, right, signal in zip(axes[::2], axes[1::2], excited, strict=False):
        _over_time(left, series, signal)
        _spectrum(right, series, signal, diagnostics)
    last = 2 * len(excited)
    axes[last - 1].set_xlabel("Frequency [Hz]")
    if winds:
        _wind(axes[last : last + 2 * winds], series, blown)
    axes[last + 2 * winds - 2].set_xlabel(with_unit("Time", series.units["t"]))
    if subspace:
        _singular_values(axes[-2], diagnostics)
        _eigenvalues(axes[-1], diagnostics)
    notes = ["shaded: training part"] if np.any(series.columns.get("train", np.zeros(1))) else []
    notes += [_idle_note(idle)] if idle else []
    notes.append("spectra: up to twice the last frequency with a tenth of the highest amplitude")
    notes += ["wind: means and deviations at the right, direction from north over east"] * (
        winds > 0
    )
    notes += _inseparable(diagnostics, dofs)
    name = f"excitation-run-{run.id}"
    return drawing_of(name, figure, figure.axes, f"Excitation, {subtitle(run)}", notes)


def _idle_note(idle: Sequence[CommandedSignal]) -> str:
    """Return `no force in sway`, or `constant: n 10 1/s`."""
    if all(not np.any(signal.commanded) and signal.dof for signal in idle):
        return f"no force in {', '.join(signal.dof for signal in idle)}"
    levels = (f"{s.name} {number_text(float(s.commanded[0]), 3)} {unit_text(s.unit)}" for s in idle)
    return f"constant: {', '.join(levels)}"


def _over_time(axes: Axes, series: Series, signal: CommandedSignal) -> None:
    t, unit = series.columns["t"], unit_text(signal.unit)
    axes.plot(t, signal.commanded, color=FORCE, linewidth=1.0, label="commanded")
    if signal.acting is not None:
        axes.plot(t, signal.acting, color=ACTING, linewidth=1.0, label="acting")
    peak = largest_of([signal.commanded])
    title = f"peak {number_text(peak, 3)} {unit}"
    if signal.limits is not None:
        limit = max(map(abs, signal.limits))
        title += f", {peak / limit:.0%} of the limit"
        for side in signal.limits if limit <= SHOWN_LIMIT * peak else ():
            axes.axhline(side, color=REFERENCE, linestyle="-.", linewidth=1.0, label="limit")
    shaded(axes, t, np.asarray(series.columns.get("train", np.zeros(0)), dtype=np.float64))
    axes.set_title(title, loc="left", fontsize=8.5, fontweight="normal")
    axes.set_ylabel(with_unit(signal.name, signal.unit))
    axes.margins(x=0)


def amplitudes(t: Sample, force: Sample) -> tuple[Sample, Sample]:
    """Return positive frequencies [Hz] and force amplitudes, shape (n // 2,) each.

    `t` [s] and `force` (in any unit) have shape (n,); the sampling is uniform.
    """
    period = float(t[-1] - t[0]) / (len(t) - 1)
    size = 2.0 * np.abs(np.fft.rfft(force - np.mean(force))) / len(force)
    frequency = np.asarray(np.fft.rfftfreq(len(force), period), dtype=np.float64)
    return frequency[1:], np.asarray(size[1:], dtype=np.float64)


def _spectrum(
    axes: Axes, series: Series, signal: CommandedSignal, diagnostics: Sequence[StoredDiagnostic]
) -> None:
    frequency, size = amplitudes(series.columns["t"], signal.commanded)
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
    values = {r.name: r.value for r in diagnostics if r.dof == signal.dof and r.name in REPORT}
    if len(values) == len(REPORT):
        rank, unknowns, lines = (int(values[name]) for name in REPORT)
        title = f"spectral lines: {lines}; {rank} of {unknowns} terms separable"
        axes.set_title(title, loc="left", fontsize=8.5, fontweight="normal")


def _inseparable(diagnostics: Sequence[StoredDiagnostic], dofs: Sequence[str]) -> Iterator[str]:
    """Yield a line for each degree of freedom with terms that the data cannot separate."""
    by_dof: dict[str, list[str]] = {}
    for row in diagnostics:
        if row.name == GROUPS and row.dof in dofs:
            by_dof.setdefault(row.dof, []).append(" ~ ".join(row.label.split()))
    return (f"{dof}, not separable: {'; '.join(groups)}" for dof, groups in by_dof.items())


def _wind(axes: Sequence[Axes], series: Series, dofs: Sequence[str]) -> None:
    """Draw speed and direction of the wind, and below them its forces and its moments."""
    speed_axes, direction_axes, *below = axes
    north, east, t = (series.columns[name] for name in (NORTH, EAST, "t"))
    speed, direction = np.hypot(north, east), blown_to(north, east)
    speed_axes.plot(t, speed, color=WIND)
    speed_axes.set_ylim(0.0, 1.1 * max(float(np.nanmax(speed)), CALM_M_S))
    speed_axes.set_ylabel("Wind speed [m/s]")
    beside(speed_axes, [_statistics(speed, "m/s", WIND)])
    direction_axes.plot(t, direction, color=WIND)
    middle = float(np.nanmean(direction)) if np.any(np.isfinite(direction)) else 0.0
    low, high = direction_axes.get_ylim()
    direction_axes.set_ylim(min(low, middle - NARROWEST_DEG), max(high, middle + NARROWEST_DEG))
    direction_axes.set_ylabel("Blows to [deg]")
    beside(direction_axes, [_statistics(direction, "deg", WIND)])
    of_force = [dof for dof in dofs if series.units[f"wind_{dof}"] == "N"]
    of_moment = [dof for dof in dofs if dof not in of_force]
    for panel, what, own in zip(below, ("force", "moment"), (of_force, of_moment), strict=False):
        if not own:
            panel.remove()
            continue
        values = {dof: series.columns[f"wind_{dof}"] for dof in own}
        unit, size = prefixed(series.units[f"wind_{own[0]}"], largest_of([*values.values()]))
        colours = {dof: PALETTE[2 + DOFS.index(dof)] for dof in own}
        panel.axhline(0.0, color="black", linewidth=0.8)
        for dof, force in values.items():
            label = f"wind, {dof}"
            panel.plot(t, force / size, color=colours[dof], linewidth=1.0, label=label)
        panel.set_ylabel(with_unit(f"Wind {what}", unit))
        beside(panel, [_statistics(v / size, unit, colours[dof]) for dof, v in values.items()])
    for panel in axes:
        panel.margins(x=0)
    axes[-1].set_xlabel(with_unit("Time", series.units["t"]))


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
    deviation = 0.0 if deviation < ROUNDING * abs(mean) else deviation
    text = f"{number_text(mean, 3)} ± {number_text(deviation, 3)} {unit_text(unit)}"
    return mean, text, colour


def _singular_values(axes: Axes, rows: Sequence[StoredDiagnostic]) -> None:
    """Draw the singular values of the data; those within the selected order are filled."""
    points = sorted((row.i, row.value) for row in rows if row.name == SINGULAR and row.value)
    if not points:
        axes.remove()
        return
    order = next((row.value for row in rows if row.name == ORDER), 0)
    unit = next(row.unit for row in rows if row.name == SINGULAR)
    axes.plot(*zip(*points, strict=True), "o-", color=FORCE, fillstyle="none")
    selected = [point for point in points if point[0] <= order]
    if selected:
        axes.plot(*zip(*selected, strict=True), "o", color=FORCE)
        title = f"filled: the selected order {order:g}"
        axes.set_title(title, loc="left", fontsize=8.5, fontweight="normal")
    axes.set_yscale("log")
    axes.set_xlabel("Number")
    axes.set_ylabel(with_unit("Singular value", unit))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))


def _eigenvalues(axes: Axes, rows: Sequence[StoredDiagnostic]) -> None:
    """Draw the eigenvalues of the identified model in the complex plane with the unit circle."""
    real, imaginary = (
        {row.i: row.value for row in rows if row.name == name} for name in (REAL, IMAGINARY)
    )
    numbers = sorted(real.keys() & imaginary.keys())
    if not numbers:
        axes.remove()
        return
    values = np.array([complex(real[k], imaginary[k]) for k in numbers])
    axes.add_patch(Circle((0.0, 0.0), 1.0, fill=False, edgecolor=MUTED, linewidth=1.2))
    axes.plot(values.real, values.imag, "o", color=FORCE, markersize=6, alpha=0.8)
    reach = 1.1 * max(1.0, float(np.max(np.abs(values))))
    axes.set_xlim(-reach, reach)
    axes.set_ylim(-reach, reach)
    axes.set_aspect("equal")
    axes.set_xlabel("Real part of the eigenvalues")
    axes.set_ylabel("Imaginary part")
