"""What `seatrial data check` reports of a recording, in the terminal and on a page with figures."""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from seatrial.models.notation import DOFS, POSE_UNIT, VELOCITY_UNIT, velocities_of
from seatrial.models.recording.column_map import FAULTS, readings, targets_of
from seatrial.models.recording.consistency import quality_checks
from seatrial.models.recording.diagnosis import Examination, examine
from seatrial.models.recording.recorded_file import ReadSignals, RecordedFile, clocks
from seatrial.models.recording.recording import piece_starts
from seatrial.models.recording.signals import Sampling, noise_floor, outliers, sampling
from seatrial.runner.compare.grid import TextTable, grid_of
from seatrial.runner.compare.page import Section, bullets, html_table, page, picture

if TYPE_CHECKING:  # slow to import
    from matplotlib.figure import Figure

MOST_OUTLIERS = 0.02  # share of the samples of a velocity
MOST_MISSING = 0.01  # share of the duration of a source in gaps
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
    for name, t in clocks(sources, columns).items():
        with suppress(*FAULTS):
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
    lines += [f"left out: {line}" for line in signals.left_out]
    for name, s in samplings.items():
        if s.gaps and s.missing > MOST_MISSING and (name in used or len(sources) == 1):
            missing = f"{name}: {s.gaps} gaps, {100.0 * s.missing:.0f} % missing"
            lines.append(f"next: {missing}: excitation.at_gap=split leaves gaps over max_gap_s out")
    for axis in known.result.axes if known else ():
        if not axis.excited:
            lines.append(f"next: {axis.dof} hardly moves: add manoeuvres that excite it")
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


def recording_page(name: str, report: Report) -> str:
    """The report of a file as one HTML file."""
    from seatrial.runner.compare.plots import style  # slow to import

    lines, tables, known = report
    parts = [("Result", bullets(lines))]
    parts += [(table.title, html_table(replace(table, title=""))) for table in tables]
    if known is not None:
        with style.drawn():
            title = "Errors of both checks; velocities, of the pose (blue) and recorded (orange)"
            parts.append((title, picture(figure(known), title, "f-")))
    sections = [Section(title, f"s{i}", [block]) for i, (title, block) in enumerate(parts)]
    return page(f"Recording {name}", [], sections)


def figure(known: Examination) -> "Figure":
    """Errors of both checks of Hoyer (2021), 5.4.4, and velocities beside those of the pose.

    One row for each axis; velocities are below the cut-off. Nothing is drawn across a gap.
    """
    from seatrial.runner.compare.plots import style

    recording, dofs = known.recording, known.recording.dofs
    (pose, integral), (nu, rates) = quality_checks(recording).values()
    both = recording.lowpassed(np.stack([rates, nu], axis=-1), known.result.cutoff_hz)
    sheet, every = style.panels(len(dofs), 3, 2.2, 1.9, share_x=True)
    for i, axes in enumerate(every):
        dof, values = dofs[i // 3], (pose - integral, nu - rates, both)[i % 3][:, i // 3]
        name = velocities_of([dof])[0] if i % 3 == 2 else f"error of {dof}"
        axes.set_ylabel(f"{name} [{(VELOCITY_UNIT if i % 3 else POSE_UNIT)[dof]}]")
        for a, b in pairwise(recording.edges):
            axes.plot(recording.t[a:b] - recording.t[0], values[a:b], linewidth=1.0)
            axes.set_prop_cycle(None)
    for axes in every[-3:]:
        axes.set_xlabel("Time [s]")
    return sheet
