"""What `seatrial data check` reports of a recording, in the terminal and on a page with figures."""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from seatrial.models.notation import DOFS, velocities_of
from seatrial.models.recording.column_map import FAULTS, readings, targets_of
from seatrial.models.recording.consistency import quality_checks
from seatrial.models.recording.diagnosis import Examination, examine
from seatrial.models.recording.recorded_file import BRIDGED, ReadSignals, RecordedFile
from seatrial.models.recording.recording import piece_starts
from seatrial.models.recording.signals import Sampling, noise_floor, outliers, sampling
from seatrial.models.recording.times import clock_of, seconds
from seatrial.models.vessel.basis import Array
from seatrial.runner.compare.blocks import bullets
from seatrial.runner.compare.formats import html_table
from seatrial.runner.compare.grid import TextTable, grid_of
from seatrial.runner.compare.page import Section, page, picture

if TYPE_CHECKING:  # slow to import
    from matplotlib.figure import Figure

MIN_SHARE_LEFT = 0.5  # share of a recording: less is left where ordinary steps count as gaps
MOST_OUTLIERS = 0.02  # share of the samples of a velocity
MOST_MISSING = 0.01  # share of the duration of a source in gaps
SHORT_S = 120.0  # [s] below which a recording is short
SAMPLING = ("source", "rows", "duration [s]", "rate [Hz]", "gaps", "longest [s]", "at [s]",
            "missing", "repeated times")  # fmt: skip
RANGES = ("signal", "unit", "least", "most", "deviation", "noise", "outliers")
COLUMNS = ("quantity", "column", "unit", "known from")
AXES = ("axis", "correlation", "scale", "excited")


Report = tuple[list[str], list[TextTable], Examination | None]  # lines, tables, what is drawn


def report(file: RecordedFile) -> Report:
    """Examine a recording by its map; what cannot be read is said, the rest is reported."""
    sources, columns, samplings = file.sources(), file.columns, dict[str, Sampling]()
    used = {reading.source.name: reading for reading in readings(sources, columns).values()}
    for name, source in sources.items():
        with suppress(*FAULTS):
            t = seconds(source, clock_of(source, columns))
            samplings[name] = sampling(t[~np.isnan(used[name].values)] if name in used else t)
    turning = "yaw" in columns.posed  # its rate may be missing: it is then differentiated
    dofs = tuple(dof for dof in DOFS if dof in columns.moving or (dof == "yaw" and turning))
    known, signals = None, ReadSignals(np.empty(0), {}, (), ())
    lines = ["problem: it cannot be read in the axes that are to be compared"]
    try:
        known = examine(file, dofs)
        if known or dofs:
            (signals,) = file.account(known.recording.dofs if known else dofs)
    except FAULTS as error:
        lines = [f"problem: {error}"]
    sampled = [
        (name or "-", *(x if isinstance(x, int) else f"{x:.6g}" for x in samples))
        for name, samples in samplings.items()
    ]
    tables = [grid_of("Sampling", SAMPLING, sampled),
              grid_of("Columns", COLUMNS, [read[:4] for read in signals.readings], 4)]  # fmt: skip
    if known is not None:
        result, lag = known.result, round(known.result.lag_s, 3) + 0.0
        counts = {option: int(np.sum(outliers(values))) for option, values in signals.values.items()
                  if option.startswith("velocity.")}  # fmt: skip
        lines = _verdict(known, signals, counts)
        title = f"Pose and velocity, below {result.cutoff_hz:.2g} Hz; the velocities are"
        axes = [(axis.dof, axis.correlation, axis.scale, "yes" if axis.excited else "no")
                for axis in result.axes]  # fmt: skip
        tables.append(grid_of(f"{title} {lag:+.3f} s behind", AXES, axes))
        tables.append(grid_of("Ranges", RANGES, [*_ranges(signals, counts)], 2, digits=3))
    slow = {name: s for name, s in samplings.items() if name in used or len(sources) == 1}
    lines += [f"left out: {line}" for line in signals.left_out]
    lines += [f"next: {line}" for line in _advice(slow, known)]
    return lines, [table for table in tables if table.rows], known


def _verdict(known: Examination, signals: ReadSignals, counts: Mapping[str, int]) -> list[str]:
    """Problems and questions, or that there is none; outliers count, too; and the current."""
    lines = [f"problem: {problem}" for problem in known.problems]
    names = ", ".join(f"{name} {count}" for name, count in counts.items() if count)
    if max(counts.values(), default=0) > MOST_OUTLIERS * len(known.recording):
        lines.append(f"problem: outliers: {names}; excitation.outliers.replace=true")
    lines += [f"question: {line}" for line in known.questions]
    if not lines and any(axis.excited for axis in known.result.axes):
        few = f"; few outliers: {names}" if names else ""
        lines = [f"no problem: pose and velocity are consistent{few}"]
    if "current.north" in signals.values:
        north, east = (float(np.nanmean(signals.values[f"current.{k}"])) for k in ("north", "east"))
        towards = np.degrees(np.arctan2(east, north)) % 360.0
        speed = np.hypot(north, east)
        lines.append(f"current: {speed:.2f} m/s towards {towards:.0f} deg on average")
    return [*lines, *(f"not compared: {line}" for line in known.not_compared)]


def _ranges(signals: ReadSignals, counts: Mapping[str, int]) -> Iterator[tuple[str | float, ...]]:
    """Range, noise and outliers of every signal, in SI units and our frames."""
    period = float(np.median(np.diff(signals.t)))
    starts = piece_starts(signals.t, period)
    for option, x in signals.values.items():
        targets, noise = targets_of(option), noise_floor(x[:, None], starts, period)
        numbers = (np.nanmin(x), np.nanmax(x), np.nanstd(x), noise.deviation[0])
        unit = targets[0] if len(targets) == 1 else "-"
        yield option, unit, *map(float, numbers), counts.get(option, "-")


def _advice(samplings: Mapping[str, Sampling], known: Examination | None) -> Iterator[str]:
    """What to do next, by the sampling of the sources in use and the motion."""
    for name, s in samplings.items():
        if s.not_later:
            rounded = "columns.time: {column: NAME, uniform: true} if they are rounded"
            yield f"{name}: {s.not_later} times are not later than the one before: {rounded}"
        if s.gaps and s.missing > MOST_MISSING:
            missing = f"{s.gaps} gaps, {100.0 * s.missing:.0f} % missing"
            yield f"{name}: {missing}: excitation.at_gap=split leaves gaps over max_gap_s out"
    if known is None:
        return
    recording = known.recording
    length = float(recording.t[-1] - recording.t[0])
    name, slowest = min(samplings.items(), key=lambda item: item[1].rate_hz or np.inf)
    kept = len(recording) * recording.period_s
    if kept <= MIN_SHARE_LEFT * length and slowest.rate_hz > 0.0:
        bridged = f"excitation.max_gap_s={BRIDGED / slowest.rate_hz:.2g} bridges the steps of"
        yield f"{kept:.0f} of {length:.0f} s are kept, the rest is in gaps: {bridged} {name}"
    if length < SHORT_S:
        yield f"the recording lasts {length:.0f} s: run several minutes"
    for axis in known.result.axes:
        if not axis.excited:
            yield f"{axis.dof} hardly moves: add manoeuvres that excite it"


def recording_page(name: str, report: Report) -> str:
    """The report of a file as one HTML file."""
    from seatrial.runner.compare.plots import style  # slow to import

    lines, tables, known = report
    parts = [("Result", bullets(lines))]
    parts += [(table.title, html_table(replace(table, title=""))) for table in tables]
    if known is not None:
        with style.drawn():
            title = "Velocities, and errors of the velocity integrated and the pose differentiated"
            parts.append((title, picture(figure(known), title, "f-")))
    sections = [Section(title, f"s{i}", [block]) for i, (title, block) in enumerate(parts)]
    return page(f"Recording {name}", [], sections)


def figure(known: Examination) -> "Figure":
    """Errors of both checks of Hoyer (2021), 5.4.4, and velocities beside those of the pose.

    Velocities are below the cut-off. Nothing is drawn across a gap.
    """
    from seatrial.runner.compare.plots import style

    recording, panels = known.recording, list[tuple[str, Array]]()
    for check in quality_checks(recording):
        panels.append((f"error of {check.dof} [{check.unit}]", check.error[:, None]))
        if check.check == "differentiated_position":
            both = np.column_stack([check.calculated, check.measured])
            name = f"{velocities_of([check.dof])[0]} [{check.unit}]"
            panels.append((name, recording.lowpassed(both, known.result.cutoff_hz)))
    sheet, every = style.panels(len(panels) // 3, 3, 2.2, 1.5, share_x=True)
    for axes, (label, values) in zip(every, panels, strict=True):
        for a, b in pairwise(recording.edges):
            axes.plot(recording.t[a:b] - recording.t[0], values[a:b], linewidth=1.0)
            axes.set_prop_cycle(None)
        axes.set_ylabel(label)
    for axes in every[-3:]:
        axes.set_xlabel("Time [s]")
    return sheet
