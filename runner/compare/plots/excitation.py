"""The excitation of a run: forces or inputs over time and their spectrum, with the limits.

Diagnostics: `regressor_rank`, `regressor_unknowns`, `spectral_lines`, and `inseparable_terms`
with the names in `label`.

What a crew or a controller commands in a run: forces by degree of freedom, or inputs by name.

Vessels by force have columns `tau_surge`, ..., steered vessels the inputs of their configuration,
such as `delta` and `n`, with `delta_command` where the command is recorded too.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.figures import Figure
from seatrial.runner.compare.frame import Queries, StoredDiagnostic, StoredRun
from seatrial.runner.compare.grid import number_text, unit_text, with_unit
from seatrial.runner.compare.plots.force_residual import shade
from seatrial.runner.compare.plots.request import PlotRequest, each_run, subtitle
from seatrial.runner.compare.plots.style import (
    PALETTE,
    REFERENCE,
    SHOWN_LIMIT,
    Drawing,
    footnote,
    headed,
    largest_of,
    limits_of,
    panels,
    prefixed,
)
from seatrial.runner.compare.statistics import Sample
from seatrial.runner.compare.where import Condition
from seatrial.runner.record.rows import Series
from seatrial.runner.vocabulary import Config

# Units of inputs by the beginning of their names, and the size of the unit.
INPUT_UNITS = {
    **dict.fromkeys(("delta", "alpha"), ("deg", float(np.radians(1.0)))),
    **dict.fromkeys(("n",), ("1/s", 1.0)),
}


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


FIGURE = Figure(
    "excitation",
    "Forces or inputs of one run, their spectrum and the limits.",
    "series recording",
    caption="Excitation of the newest run and its spectrum",
    place=13,
)

REPORT = ("regressor_rank", "regressor_unknowns", "spectral_lines")
GROUPS = "inseparable_terms"
MATTERS = 0.1  # smallest amplitude that matters, relative to the largest, both smoothed
DEPTH = 1e-3  # smallest amplitude shown, likewise
FORCE, ACTING = PALETTE[0], PALETTE[1]


def drawings(results: Queries, request: PlotRequest) -> list[Drawing]:
    """Draw one figure of one run (with --facet, for each level), one row for each signal."""
    return [_drawing(results, request, run) for run, _ in each_run(results, request, ["recording"])]


def _drawing(results: Queries, request: PlotRequest, run: StoredRun) -> Drawing:
    series = results.reader.series(run.id, "recording")
    dofs = request.shown(lambda dof: f"tau_{dof}" in series.columns) or list(request.dofs)
    signals = commanded_signals(series, results.reader.run(run.id).config, dofs)
    excited = [s for s in signals if np.any(s.commanded if s.dof else np.diff(s.commanded))]
    excited = excited or [signal for signal in signals if np.any(signal.commanded)]
    idle = [signal for signal in signals if signal not in excited]
    if not excited:
        raise ConfigurationError(f"plot excitation: run {run.id} has no force in these DOFs")
    diagnostics = results.diagnostics([run], (*REPORT, GROUPS), Condition(run=run.id))[run.id]
    figure, axes = panels(len(excited), 2, 5.4, 2.3 if len(excited) > 1 else 3.2)
    for left, right, signal in zip(axes[::2], axes[1::2], excited, strict=True):
        _over_time(left, series, signal)
        _spectrum(right, series, signal, diagnostics)
    axes[-2].set_xlabel(with_unit("Time", series.units["t"]))
    axes[-1].set_xlabel("Frequency [Hz]")
    headed(figure, axes, f"Excitation, {subtitle(run)}")
    notes = ["shaded: training part"] if np.any(series.columns.get("train", np.zeros(1))) else []
    notes += [_idle_note(idle)] if idle else []
    notes.append("spectra: up to twice the last frequency with a tenth of the highest amplitude")
    footnote(figure, [*notes, *_inseparable(diagnostics, dofs)])
    return Drawing(f"excitation-run-{run.id}", figure)


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
    shade(axes, t, np.asarray(series.columns.get("train", np.zeros(0)), dtype=np.float64))
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


def _inseparable(diagnostics: Sequence[StoredDiagnostic], dofs: Sequence[str]) -> list[str]:
    """Return a line for each degree of freedom with terms that the data cannot separate."""
    by_dof: dict[str, list[str]] = {}
    for row in diagnostics:
        if row.name == GROUPS and row.dof in dofs:
            by_dof.setdefault(row.dof, []).append(" ~ ".join(row.label.split()))
    return [f"{dof}, not separable: {'; '.join(groups)}" for dof, groups in by_dof.items()]
