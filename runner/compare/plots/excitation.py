"""The excitation of a run: forces over time and their spectrum, with the thrusters' limits.

Diagnostics: `regressor_rank`, `regressor_unknowns`, `spectral_lines`, and `inseparable_terms`
with the names in `label`.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.figures import Figure
from seatrial.runner.compare.grid import number_text, unit_text, with_unit
from seatrial.runner.compare.plots.force_residual import shade
from seatrial.runner.compare.plots.request import PlotRequest, each_run, subtitle, with_run
from seatrial.runner.compare.plots.style import (
    PALETTE,
    REFERENCE,
    Drawing,
    footnote,
    headed,
    panels,
)
from seatrial.runner.compare.results import DiagnosticRow, Results, Run
from seatrial.runner.compare.statistics import Sample
from seatrial.runner.database.records import Series

FIGURE = Figure(
    "excitation",
    "Forces of one run, their spectrum and the limits.",
    "series recording",
    caption="Forces of the newest run and their spectrum",
    place=13,
)

REPORT = ("regressor_rank", "regressor_unknowns", "spectral_lines")
GROUPS = "inseparable_terms"
NEAR = 2.5  # a limit above this multiple of the peak is not drawn
DEPTH = 1e-4  # smallest amplitude shown, relative to the largest
FORCE, ACTING = PALETTE[0], PALETTE[1]


def drawings(results: Results, request: PlotRequest) -> list[Drawing]:
    """Draw one figure of one run (with --facet, for each level), one row for each DOF."""
    return [_drawing(results, request, run) for run, _ in each_run(results, request, ["recording"])]


def _drawing(results: Results, request: PlotRequest, run: Run) -> Drawing:
    series = results.reader.series(run.id, "recording")
    dofs = request.shown(lambda dof: f"tau_{dof}" in series.columns)
    idle = [dof for dof in dofs if not np.any(series.columns[f"tau_{dof}"])]
    excited = [dof for dof in dofs if dof not in idle]
    if not excited:
        raise ConfigurationError(f"plot excitation: run {run.id} has no force in these DOFs")
    limits = limits_of(results.reader.run(run.id).config)
    findings = results.diagnostics([run], (*REPORT, GROUPS), with_run(None, run.id))[run.id]
    figure, axes = panels(len(excited), 2, 5.4, 2.3)
    for left, right, dof in zip(axes[::2], axes[1::2], excited, strict=True):
        _forces(left, series, dof, limits.get(dof))
        _spectrum(right, series, dof, findings)
    axes[-2].set_xlabel(with_unit("Time", series.units["t"]))
    axes[-1].set_xlabel("Frequency [Hz]")
    headed(figure, axes, f"Excitation, {subtitle(run)}")
    notes = ["shaded: training part"] if np.any(series.columns.get("train", np.zeros(1))) else []
    notes += [f"no force in {', '.join(idle)}"] if idle else []
    footnote(figure, [*notes, *_inseparable(findings, dofs)])
    return Drawing(f"excitation-run-{run.id}", figure)


def limits_of(config: Mapping[str, Any]) -> dict[str, float]:
    """Return the thrusters' limits [N, Nm] by degree of freedom, if the vessel has them."""
    vessel = config.get("vessel", {})
    return dict(zip(vessel.get("dofs") or (), vessel.get("force_limits") or (), strict=False))


def _forces(axes: Axes, series: Series, dof: str, limit: float | None) -> None:
    t, force = series.columns["t"], series.columns[f"tau_{dof}"]
    unit = series.units[f"tau_{dof}"]
    acting = series.columns.get(f"tau_actual_{dof}")
    axes.plot(t, force, color=FORCE, linewidth=1.0, label="commanded")
    if acting is not None and not np.allclose(acting[1:], force[:-1]):
        axes.plot(t, acting, color=ACTING, linewidth=1.0, label="acting")
    peak = float(np.max(np.abs(force)))
    title = f"peak {number_text(peak, 3)} {unit_text(unit)}"
    if limit is not None:
        title += f", {peak / limit:.0%} of the limit"
        if limit <= NEAR * peak:
            for side in (-limit, limit):
                axes.axhline(side, color=REFERENCE, linestyle="--", linewidth=1.0, label="limit")
    shade(axes, t, np.asarray(series.columns.get("train", np.zeros(0)), dtype=np.float64))
    axes.set_title(title, loc="left", fontsize=8.5, fontweight="normal")
    axes.set_ylabel(with_unit(dof.capitalize(), unit))
    axes.margins(x=0)


def amplitudes(t: Sample, force: Sample) -> tuple[Sample, Sample]:
    """Return positive frequencies [Hz] and force amplitudes, shape (n // 2,) each.

    `t` [s] and `force` [N or Nm] have shape (n,); the sampling is uniform.
    """
    period = float(t[-1] - t[0]) / (len(t) - 1)
    size = 2.0 * np.abs(np.fft.rfft(force - np.mean(force))) / len(force)
    frequency = np.asarray(np.fft.rfftfreq(len(force), period), dtype=np.float64)
    return frequency[1:], np.asarray(size[1:], dtype=np.float64)


def _spectrum(axes: Axes, series: Series, dof: str, findings: Sequence[DiagnosticRow]) -> None:
    frequency, size = amplitudes(series.columns["t"], series.columns[f"tau_{dof}"])
    axes.set_xscale("log")
    axes.set_ylabel(with_unit("Amplitude", series.units[f"tau_{dof}"]))
    axes.set_xlim(frequency[0], frequency[-1])
    largest = float(np.max(size))
    if largest > 0.0:
        axes.set_yscale("log")
        axes.plot(frequency, size, color=FORCE, linewidth=0.8)
        axes.set_ylim(DEPTH * largest, 2.0 * largest)
    values = {row.name: row.value for row in findings if row.dof == dof and row.name in REPORT}
    if len(values) == len(REPORT):
        rank, unknowns, lines = (int(values[name]) for name in REPORT)
        title = f"spectral lines: {lines}; {rank} of {unknowns} terms separable"
        axes.set_title(title, loc="left", fontsize=8.5, fontweight="normal")


def _inseparable(findings: Sequence[DiagnosticRow], dofs: Sequence[str]) -> list[str]:
    """Return a line for each degree of freedom with terms that the data cannot separate."""
    by_dof: dict[str, list[str]] = {}
    for row in findings:
        if row.name == GROUPS and row.dof in dofs:
            by_dof.setdefault(row.dof, []).append(" ~ ".join(row.label.split()))
    return [f"{dof}, not separable: {'; '.join(groups)}" for dof, groups in by_dof.items()]
