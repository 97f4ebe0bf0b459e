"""The page about a recording: the tables of the report, and figures."""

from itertools import pairwise
from typing import Any

import numpy as np
import scipy
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from seatrial.models.notation import POSE_UNIT, velocities_of
from seatrial.models.recording.diagnosis import Examination
from seatrial.models.recording.preprocessing import QualityCheck, quality_checks
from seatrial.models.recording.recording import Recording
from seatrial.models.recording.smoothing import SEGMENT
from seatrial.models.vessel.basis import Array
from seatrial.runner.compare.page import picture, render_page
from seatrial.runner.compare.plots import style
from seatrial.runner.recording_report import Report


def page(report: Report) -> str:
    """The report as one HTML file."""
    pictures = []
    if report.examination is not None:
        known = report.examination
        checks = quality_checks(known.recording)
        with style.drawn():
            sheets = {
                "Velocities, recorded and from the pose": velocities(known, checks),
                "Integrated velocity and differentiated position": errors(known.recording, checks),
                "Spectra of the velocities": spectra(known),
                "Track": track(known.recording),
            }
            pictures = [
                picture(sheet, text, f"f{i}-") for i, (text, sheet) in enumerate(sheets.items())
            ]
    return render_page(
        "recording.html", title=f"Recording {report.path}", report=report, pictures=pictures
    )


def _draw(axes: Axes, recording: Recording, values: Array, **how: Any) -> None:
    """Draw values (N,) over time, piece by piece: nothing is drawn across a gap."""
    t = recording.t - recording.t[0]
    for a, b in pairwise([*np.flatnonzero(recording.piece_starts).tolist(), len(t)]):
        axes.plot(t[a:b], values[a:b], **how)
        how.pop("label", None)


def velocities(known: Examination, checks: tuple[QualityCheck, ...]) -> Figure:
    """Each velocity as recorded, and as the pose implies it, below the cut-off."""
    recording, cutoff = known.recording, known.result.cutoff_hz
    sheet, panels = style.panels(len(recording.dofs), 1, 6.5, 1.5, share_x=True)
    rates = [check for check in checks if check.check == "differentiated_position"]
    for axes, check in zip(panels, rates, strict=True):
        both = np.column_stack([check.calculated, check.measured])
        both = recording.lowpassed(both, cutoff)
        _draw(axes, recording, both[:, 0], color=style.PALETTE[1], label="from the pose")
        _draw(axes, recording, both[:, 1], color=style.PALETTE[0], label="recorded", linewidth=1.0)
        axes.set_ylabel(f"{velocities_of([check.dof])[0]} [{check.unit}]")
    panels[0].legend(ncols=2, loc="lower right", bbox_to_anchor=(1.0, 1.0))
    panels[-1].set_xlabel("Time [s]")
    return sheet


def errors(recording: Recording, checks: tuple[QualityCheck, ...]) -> Figure:
    """Integrated velocity less position, which drifts, and differentiated position less velocity.

    Hoyer (2021), section 5.4.4.
    """
    sheet, panels = style.panels(len(recording.dofs), 2, 3.25, 1.5, share_x=True)
    titles = ("Integrated velocity - position", "Rate of position - velocity")
    for i, (axes, check) in enumerate(zip(panels, checks, strict=True)):
        error = check.calculated - check.measured
        _draw(axes, recording, error, color=style.PALETTE[0], linewidth=0.8)
        axes.set_ylabel(f"{check.dof} [{check.unit}]")
        axes.set_title(titles[i] if i < 2 else "", fontsize=10, fontweight="normal")
    for axes in panels[-2:]:
        axes.set_xlabel("Time [s]")
    return sheet


def spectra(known: Examination) -> Figure:
    """Densities of the recorded velocities, of the longest piece."""
    recording = max(known.recording.pieces(), key=len)
    sheet = style.figure(6.5, 3.5)
    axes = sheet.subplots()
    frequency, density = scipy.signal.welch(
        recording.nu, 1.0 / recording.period_s, nperseg=min(len(recording), SEGMENT), axis=0
    )
    for i, name in enumerate(velocities_of(recording.dofs)):
        axes.loglog(
            frequency[1:], np.maximum(density[1:, i], 1e-20), label=name, color=style.PALETTE[i]
        )
    axes.axvline(known.result.cutoff_hz, color=style.MUTED, linestyle=":", label="cut-off")
    axes.set_xlabel("Frequency [Hz]")
    axes.set_ylabel("Density [unit²/Hz]")
    axes.legend(ncols=4, loc="lower right", bbox_to_anchor=(1.0, 1.0))
    return sheet


def track(recording: Recording) -> Figure:
    """The path of the horizontal positions, or the first position over time."""
    sheet = style.figure(6.5, 4.5)
    axes = sheet.subplots()
    if {"surge", "sway"} <= set(recording.dofs):
        for piece in recording.pieces():
            north, east = (piece.eta[:, piece.dofs.index(dof)] for dof in ("surge", "sway"))
            axes.plot(east, north, color=style.PALETTE[0], linewidth=1.0)
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_xlabel("East [m]")
        axes.set_ylabel("North [m]")
    else:
        _draw(axes, recording, recording.eta[:, 0], color=style.PALETTE[0])
        axes.set_xlabel("Time [s]")
        axes.set_ylabel(f"Position in {recording.dofs[0]} [{POSE_UNIT[recording.dofs[0]]}]")
    return sheet
