"""What `seatrial data check` reports of a recording, in the terminal and on a page with figures."""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from seatrial.models.notation import DOFS, velocities_of
from seatrial.models.recording.consistency import quality_checks
from seatrial.models.recording.diagnosis import Examination, examine
from seatrial.models.recording.preprocessing import outliers
from seatrial.models.recording.reader import BRIDGED, FAULTS, ReadSignals, clock_of, readings
from seatrial.models.recording.recorded_file import RecordedFile
from seatrial.models.recording.recording import Recording, piece_starts
from seatrial.models.recording.sampling import Sampling, sampling
from seatrial.models.recording.smoothing import noise_floor
from seatrial.models.recording.times import seconds
from seatrial.models.recording.units import targets_of
from seatrial.models.vessel.basis import Array
from seatrial.runner.compare.formats import html_table
from seatrial.runner.compare.grid import TextTable, grid_of
from seatrial.runner.compare.page import Section, bullets, page, picture

if TYPE_CHECKING:  # slow to import
    from matplotlib.figure import Figure

MIN_SHARE_LEFT = 0.5  # share of a recording: less is left where ordinary steps count as gaps
MOST_OUTLIERS = 0.02  # share of the samples of a velocity
MOST_MISSING = 0.01  # share of the duration of a source in gaps
SHORT_S = 120.0  # [s] below which a recording is short
SAMPLING = ("source", "rows", "duration [s]", "rate [Hz]", "gaps", "longest [s]", "missing [%]",
            "repeated times")  # fmt: skip
RANGES = ("signal", "unit", "least", "most", "deviation", "noise", "outliers")
COLUMNS = ("quantity", "column", "unit", "known from")
AXES = ("axis", "correlation", "scale", "excited")


@dataclass(frozen=True)
class Report:
    """What the terminal and the page show, in this order; `examination` is drawn on the page."""

    path: str
    verdict: tuple[str, ...]  # problems and questions, or that there is none
    tables: tuple[TextTable, ...]
    left_out: tuple[str, ...]
    advice: tuple[str, ...]
    examination: Examination | None


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
    why = "it cannot be read in the axes that are to be compared"
    try:
        known = examine(file, dofs)
        if known or dofs:
            (signals,) = file.account(known.recording.dofs if known else dofs)
    except FAULTS as error:
        why = str(error)
    sampled = [
        (name or "-", s.count, f"{s.duration_s:.1f}", f"{s.rate_hz:.4g}", s.gaps,
         f"{s.longest_gap_s:.3g} at {s.longest_gap_at_s:.0f}" if s.gaps else "-",
         f"{100.0 * s.missing:.1f}", s.not_later)
        for name, s in samplings.items()
    ]  # fmt: skip
    units = [(read.option, read.column, read.unit or "-", read.known_from)
             for read in signals.readings]  # fmt: skip
    tables = [grid_of("Sampling", SAMPLING, sampled), grid_of("Columns", COLUMNS, units, 4)]
    if known is not None:
        result, lag = known.result, round(known.result.lag_s, 3) + 0.0
        title = f"Pose and velocity, below {result.cutoff_hz:.2g} Hz; the velocities are"
        axes = [(axis.dof, f"{axis.correlation:.3f}", f"{axis.scale:.3f}",
                 "yes" if axis.excited else "no") for axis in result.axes]  # fmt: skip
        tables.append(grid_of(f"{title} {lag:+.3f} s behind", AXES, axes))
        tables.append(grid_of("Ranges", RANGES, _ranges(signals), 2))
    slow = {name: s for name, s in samplings.items() if name in used or len(sources) == 1}
    advice = list(_advice(slow, known.recording if known else None))
    if known:
        advice += [f"{axis.dof} hardly moves: add manoeuvres that excite it"
                   for axis in known.result.axes if not axis.excited]  # fmt: skip
        advice = advice or [f"ready for a trial: seatrial vessel=NAME excitation=recording "
                            f"excitation.path={file.path} excitation.map=MAP.yaml"]  # fmt: skip
    verdict = [f"problem: {why}"] if known is None else _verdict(known, signals)
    filled = tuple(table for table in tables if table.rows)
    return Report(str(file.path), tuple(verdict), filled, signals.left_out, tuple(advice), known)


def _verdict(known: Examination, signals: ReadSignals) -> list[str]:
    """Problems and questions, or that there is none; outliers count, too; and the current."""
    lines = [f"problem: {problem}" for problem in known.problems]
    counts = {name: count for name, count in _outliers(signals).items() if count}
    names = ", ".join(f"{name} {count}" for name, count in counts.items())
    if max(counts.values(), default=0) > MOST_OUTLIERS * len(known.recording):
        lines.append(f"problem: outliers: {names}; excitation.outliers.replace=true")
    lines += [f"question: {line}" for line in known.questions]
    if not lines and any(axis.excited for axis in known.result.axes):
        few = f"; few outliers: {names}" if names else ""
        lines = [f"no problem: pose and velocity are consistent{few}"]
    if "current.north" in signals.values:
        mean = {option: float(np.nanmean(x)) for option, x in signals.values.items()}
        north, east = mean["current.north"], mean["current.east"]
        towards = np.degrees(np.arctan2(east, north)) % 360.0
        speed = np.hypot(north, east)
        lines.append(f"current: {speed:.2f} m/s towards {towards:.0f} deg on average")
    return [*lines, *(f"not compared: {line}" for line in known.not_compared)]


def _ranges(signals: ReadSignals) -> list[tuple[str | int, ...]]:
    """Range, noise and outliers of every signal, in SI units and our frames."""
    period, counts = float(np.median(np.diff(signals.t))), _outliers(signals)
    starts, rows = piece_starts(signals.t, period), list[tuple[str | int, ...]]()
    for option, x in signals.values.items():
        targets, noise = targets_of(option), noise_floor(x[:, None], starts, period)
        numbers = (np.nanmin(x), np.nanmax(x), np.nanstd(x), noise.deviation[0])
        unit = targets[0] if len(targets) == 1 else "-"
        rows.append((option, unit, *(f"{n:.3g}" for n in numbers), counts.get(option, "-")))
    return rows


def _outliers(signals: ReadSignals) -> dict[str, int]:
    """The number of outliers of each velocity."""
    return {option: int(np.sum(outliers(values))) for option, values in signals.values.items()
            if option.startswith("velocity.")}  # fmt: skip


def _advice(samplings: Mapping[str, Sampling], recording: Recording | None) -> Iterator[str]:
    """What to do next, by the sampling of the sources in use."""
    for name, s in samplings.items():
        if s.not_later:
            rounded = "columns.time: {column: NAME, uniform: true} if they are rounded"
            yield f"{name}: {s.not_later} times are not later than the one before: {rounded}"
        if s.gaps and s.missing > MOST_MISSING:
            yield f"{name}: {s}: excitation.at_gap=split leaves gaps longer than max_gap_s out"
    if recording is None:
        return
    length = float(recording.t[-1] - recording.t[0])
    name, slowest = min(samplings.items(), key=lambda item: item[1].rate_hz or np.inf)
    kept = len(recording) * recording.period_s
    if kept <= MIN_SHARE_LEFT * length and slowest.rate_hz > 0.0:
        bridged = f"excitation.max_gap_s={BRIDGED / slowest.rate_hz:.2g} bridges the steps of"
        yield f"{kept:.0f} of {length:.0f} s are kept, the rest is in gaps: {bridged} {name}"
    if length < SHORT_S:
        yield f"the recording lasts {length:.0f} s: run several minutes"


def recording_page(known: Report) -> str:
    """The report as one HTML file."""
    from seatrial.runner.compare.plots import style  # slow to import

    told = {"Result": known.verdict, "What was left out": known.left_out,
            "What to do next": known.advice}  # fmt: skip
    parts = [(title, bullets(lines)) for title, lines in told.items() if lines]
    parts += [(sheet.title, html_table(replace(sheet, title=""))) for sheet in known.tables]
    if known.examination is not None:
        with style.drawn():
            title = "Velocities, and errors of the velocity integrated and the pose differentiated"
            parts.append((title, picture(figure(known.examination), title, "f-")))
    sections = [Section(title, f"s{i}", [block]) for i, (title, block) in enumerate(parts)]
    return page(f"Recording {known.path}", [], sections)


def figure(known: Examination) -> "Figure":
    """Velocities beside those of the pose, and errors of both checks of Hoyer (2021), 5.4.4.

    Velocities are below the cut-off. Integrated velocity less position shows drift, differentiated
    position less velocity wrong signs, frames and time stamps. Nothing is drawn across a gap.
    """
    from seatrial.runner.compare.plots import style

    recording, panels = known.recording, list[tuple[str, Array]]()
    for check in quality_checks(recording):
        panels.append((f"error of {check.dof} [{check.unit}]", -check.error[:, None]))
        if check.check == "differentiated_position":
            both = np.column_stack([check.calculated, check.measured])
            name = f"{velocities_of([check.dof])[0]} [{check.unit}]"
            panels.append((name, recording.lowpassed(both, known.result.cutoff_hz)))
    sheet, every = style.panels(len(panels) // 3, 3, 2.2, 1.5, share_x=True)
    t = recording.t - recording.t[0]
    for axes, (label, values) in zip(every, panels, strict=True):
        for a, b in pairwise(recording.edges):
            for colour, value in zip((1, 0), values.T, strict=False):
                axes.plot(t[a:b], value[a:b], color=style.PALETTE[colour], linewidth=1.0)
        axes.set_ylabel(label)
    for axes in every[-3:]:
        axes.set_xlabel("Time [s]")
    return sheet
