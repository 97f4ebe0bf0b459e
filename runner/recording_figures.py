"""Figures of the page about a recording."""

import numpy as np
import scipy
from matplotlib.figure import Figure
from numpy.typing import NDArray

from seatrial.models.notation import VELOCITY_UNIT, velocities_of
from seatrial.models.recording.diagnosis import Examination
from seatrial.models.recording.motion import Motion
from seatrial.models.recording.smoothing import SEGMENT
from seatrial.runner.compare.plots import style

SHOWN_S = 300.0  # [s] of the time series that are drawn


def velocities(known: Examination) -> Figure:
    """Each velocity as recorded, and as the pose implies it."""
    recording, cutoff = known.recording, known.result.cutoff_hz
    motion = Motion(recording)
    dofs = recording.dofs
    own, implied = motion.velocity(dofs, cutoff), motion.rates(dofs, cutoff)
    count = min(len(own), round(SHOWN_S / recording.period_s))
    t = recording.period_s * np.arange(count)
    sheet = style.figure(6.5, 1.3 * len(dofs) + 0.8)
    panels: NDArray[np.object_] = np.atleast_1d(sheet.subplots(len(dofs), 1, sharex=True))
    for i, (axes, dof) in enumerate(zip(panels, dofs, strict=True)):
        axes.plot(t, implied[:count, i], color=style.PALETTE[1], label="from the pose")
        axes.plot(t, own[:count, i], color=style.PALETTE[0], label="recorded", linewidth=1.0)
        axes.set_ylabel(f"{velocities_of([dof])[0]} [{VELOCITY_UNIT[dof]}]")
    panels[0].legend(ncols=2, loc="lower right", bbox_to_anchor=(1.0, 1.0))
    panels[-1].set_xlabel("Time [s]")
    return sheet


def spectra(known: Examination) -> Figure:
    """Densities of the recorded velocities."""
    recording = known.recording
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


def track(known: Examination) -> Figure:
    """The path of the horizontal positions, or the first position over time."""
    recording = known.recording
    sheet = style.figure(6.5, 4.5)
    axes = sheet.subplots()
    if {"surge", "sway"} <= set(recording.dofs):
        north = recording.eta[:, recording.dofs.index("surge")]
        east = recording.eta[:, recording.dofs.index("sway")]
        for piece in np.split(
            np.arange(len(recording)), np.flatnonzero(recording.piece_starts)[1:]
        ):
            axes.plot(east[piece], north[piece], color=style.PALETTE[0], linewidth=1.0)
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_xlabel("East [m]")
        axes.set_ylabel("North [m]")
    else:
        axes.plot(recording.t, recording.eta[:, 0], color=style.PALETTE[0])
        axes.set_xlabel("Time [s]")
        axes.set_ylabel(f"Position in {recording.dofs[0]}")
    return sheet
