"""The page about a recording: the tables of the report, and figures."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from matplotlib.figure import Figure

from seatrial.models.notation import velocities_of
from seatrial.models.recording.diagnosis import Examination
from seatrial.models.recording.preprocessing import quality_checks
from seatrial.models.recording.recording import Recording
from seatrial.models.vessel.basis import Array
from seatrial.runner.commands.recording_report import Report
from seatrial.runner.compare.formats import html_table
from seatrial.runner.compare.page import Section, bullets, page, picture
from seatrial.runner.compare.plots import style


def recording_page(report: Report) -> str:
    """The report as one HTML file."""
    told = {
        "Result": report.verdict, "What was left out": report.left_out,
        "What to do next": report.advice,
    }  # fmt: skip
    parts = [(title, bullets(lines)) for title, lines in told.items() if lines]
    parts += [(sheet.title, html_table(replace(sheet, title=""))) for sheet in report.tables]
    with style.drawn():
        sheets = {} if report.examination is None else figures(report.examination)
        drawn = enumerate(sheets.items())
        parts += [(text, picture(sheet, text, f"f{i}-")) for i, (text, sheet) in drawn]
    sections = [Section(title, f"s{i}", [block]) for i, (title, block) in enumerate(parts)]
    return page(f"Recording {report.path}", [], sections)


def figures(known: Examination) -> dict[str, Figure]:
    """Velocities beside those of the pose, errors of both checks of Hoyer (2021), 5.4.4, the track.

    Velocities are below the cut-off. Integrated velocity less position shows drift, differentiated
    position less velocity wrong signs, frames and time stamps.
    """
    recording, velocities, errors = known.recording, [], []
    for check in quality_checks(recording):
        if check.check == "differentiated_position":
            both = np.column_stack([check.calculated, check.measured])
            name = f"{velocities_of([check.dof])[0]} [{check.unit}]"
            velocities.append((name, recording.lowpassed(both, known.result.cutoff_hz)))
        errors.append((f"error of {check.dof} [{check.unit}]", -check.error[:, None]))
    result = {
        "Velocities, from the pose and recorded": _over_time(recording, velocities, 1),
        "Integrated velocity less position, rate of position less velocity":
            _over_time(recording, errors, 2),
    }  # fmt: skip
    if {"surge", "sway"} <= set(recording.dofs):
        sheet = style.figure(6.5, 4.5)
        axes = sheet.subplots()
        for piece in recording.pieces():
            north, east = (piece.eta[:, piece.dofs.index(dof)] for dof in ("surge", "sway"))
            axes.plot(east, north, color=style.PALETTE[0], linewidth=1.0)
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_xlabel("East [m]")
        axes.set_ylabel("North [m]")
        result["Track"] = sheet
    return result


def _over_time(recording: Recording, panels: Sequence[tuple[str, Array]], columns: int) -> Figure:
    """Values (N, k) of each panel over time, piece by piece: nothing is drawn across a gap."""
    sheet, every = style.panels(len(panels) // columns, columns, 6.5 / columns, 1.5, share_x=True)
    t = recording.t - recording.t[0]
    for axes, (label, values) in zip(every, panels, strict=True):
        for a, b in pairwise(recording.edges):
            for colour, value in zip((1, 0), values.T, strict=False):
                axes.plot(t[a:b], value[a:b], color=style.PALETTE[colour], linewidth=1.0)
        axes.set_ylabel(label)
    for axes in every[-columns:]:
        axes.set_xlabel("Time [s]")
    return sheet
