"""Whether pose, velocity and acceleration of a recording belong together, and what would mend it.

    eta_dot = J(eta) nu,    nu_dot = d nu / dt

The derivative of the pose in body axes is compared with the recorded velocity per axis, and the
derivative of the velocity with the recorded acceleration. What does not agree is tried again as
people record it: in other units, with axes exchanged or reversed, velocities along the axes of the
earth, poses in ENU for NED, headings that count anticlockwise, from east or in degrees, and clocks
that are apart. The simplest reading that agrees as well as the best one is taken.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from seatrial.models.notation import DOFS
from seatrial.models.recording.agreement import (
    CERTAIN,
    Agreement,
    correlations,
    fisher,
    lag,
    scale_of,
)
from seatrial.models.recording.motion import AS_GOOD, DEGREE, READINGS, Motion, Reading
from seatrial.models.recording.recording import Recording

LONGEST_LAG_S = 5.0  # [s]
SURE = 0.5  # correlation of an axis whose scale is known
LEAST_TRUSTED = 0.3  # correlation of an excited axis below which a trial refuses a recording


@dataclass(frozen=True)
class Consistency:
    """Agreement of each axis as recorded, and how the recording agrees best.

    `best` are the agreements with `reading`, axes exchanged where that is significantly better and
    velocities shifted by `lag_s`, by which they are behind the pose.
    """

    velocities: tuple[Agreement, ...]
    accelerations: tuple[Agreement, ...]
    best: tuple[Agreement, ...]
    reading: Reading
    lag_s: float
    shared_lag_s: float  # of all axes; what exceeds it is the delay of a filter
    lag_error_s: float
    period_s: float
    cutoff_hz: float
    samples: float  # independent ones below the cut-off

    @property
    def untrusted(self) -> tuple[Agreement, ...]:
        """Excited axes whose correlation is too low for an identification."""
        axes = (*self.velocities, *self.accelerations)
        return tuple(a for a in axes if a.excited and a.correlation < LEAST_TRUSTED)

    def significant(self, axis: Agreement) -> bool:
        """Whether an axis agrees at all, with either sign."""
        error = 1.0 / np.sqrt(max(self.samples - 3.0, 1.0))
        return bool(fisher(np.array(axis.correlation)) > CERTAIN * error)


def consistency(recording: Recording, measured: Sequence[str] = ()) -> Consistency:
    """Compare the pose, the velocity and the acceleration of a recording.

    `measured` are the degrees of freedom whose acceleration is recorded, not differentiated.
    """
    motion = Motion(recording)
    plain = motion.plain(motion.best_band())
    lag_s = 0.0
    while True:  # a lag of half a period would look like a wrong sign: shift and look once more
        shifted = Motion(_ahead(recording, lag_s))
        cutoff = shifted.best_band()
        reading, best = _best_reading(shifted, cutoff)
        more, error = _lag(shifted, cutoff, reading, best)
        first = lag_s == 0.0
        lag_s += more
        if not first or abs(more) < recording.period_s:
            break
    shared = _shared_lag(Motion(_ahead(recording, lag_s)), cutoff, reading, best, lag_s)
    return Consistency(
        plain, _accelerations(motion, cutoff, measured), best, reading, lag_s, shared, error,
        recording.period_s, cutoff, motion.samples(cutoff),
    )  # fmt: skip


def _best_reading(motion: Motion, cutoff_hz: float) -> tuple[Reading, tuple[Agreement, ...]]:
    """The simplest reading that agrees as well as the best one, and the agreement of its axes."""
    degrees = _in_degrees(motion, cutoff_hz)
    tried: list[tuple[float, float, Reading, tuple[Agreement, ...]]] = []
    for reading in READINGS if motion.turns else READINGS[:1]:
        if tried and tried[0][0] >= 1.0 - AS_GOOD and tried[0][1] == 0.0:
            break  # nothing is simpler or better
        reading = replace(reading, degrees=degrees)
        angular = motion.compared(motion.angular, cutoff_hz, reading)
        linear = motion.compared(motion.linear, cutoff_hz, reading)
        axes = (*linear, *angular)
        known = [axis for axis in axes if motion.moves(axis.dof, cutoff_hz)]
        score = float(np.mean([axis.correlation**2 for axis in known])) if known else 0.0
        flips = sum(axis.correlation < 0.0 for axis in known)
        exchanges = sum(axis.other != axis.dof for axis in axes) / 2.0
        tried.append((score, reading.changes + flips + exchanges, reading, axes))
    best = max(score for score, *_ in tried)
    as_good = [row for row in tried if row[0] >= best - AS_GOOD]
    _, _, reading, axes = min(as_good, key=lambda row: row[1])
    return reading, axes


def _in_degrees(motion: Motion, cutoff_hz: float) -> tuple[str, ...]:
    """The angles whose derivatives are about 57.3 times the angular velocities.

    The derivatives are those of each angle by itself: one angle in degrees would spoil the others
    in J(eta). What exceeds 98 % of them is cut, since a heading of 360 degrees jumps to zero.
    """
    large = []
    for dof in motion.angular:
        angle = motion.recording.attitude[:, [DOFS[3:].index(dof)]]
        rate = motion.derivative(angle)
        expected = motion.inside(np.clip(rate, *np.percentile(rate, (2.0, 98.0))), cutoff_hz)
        observed = motion.velocity([dof], cutoff_hz)
        rho = float(correlations(observed, expected)[0, 0])
        scale = abs(scale_of(observed[:, 0], expected[:, 0], rho))
        if abs(rho) > SURE and 0.5 < scale * DEGREE < 2.0:
            large.append(dof)
    # Roll and pitch of one instrument are in the same unit, even if one of them hardly moves.
    if set(large) & {"roll", "pitch"}:
        large += [dof for dof in ("roll", "pitch") if dof in motion.angular]
    return tuple(dof for dof in DOFS if dof in large)


def _ahead(recording: Recording, seconds: float) -> Recording:
    """The recording with the velocities that it holds `seconds` later."""
    if seconds == 0.0:
        return recording
    t = recording.t
    nu = np.column_stack([np.interp(t + seconds, t, column) for column in recording.nu.T])
    return replace(recording, nu=nu)


def _lag(
    motion: Motion, cutoff_hz: float, reading: Reading, axes: Sequence[Agreement]
) -> tuple[float, float]:
    """By how much the velocities are behind the pose, and its standard error [s].

    The error of a delay between band-limited signals of correlation rho with n independent samples
    is sqrt((1 / rho^2 - 1) / n) / (2 pi f_rms); Carter (1987), Proc IEEE 75(2).
    """
    used = [axis for axis in axes if axis.excited]
    period = motion.recording.period_s
    if not used:
        return 0.0, np.inf
    observed = motion.velocity([axis.dof for axis in used], cutoff_hz)
    expected = motion.rates([axis.other for axis in used], cutoff_hz, reading)
    observed = observed * np.sign([axis.scale for axis in used])
    most = round(LONGEST_LAG_S / period)
    seconds = lag(observed, expected, most) * period
    rho = max(abs(axis.correlation) for axis in used)
    share = max(1.0 / max(rho, 0.01) ** 2 - 1.0, 1e-6)
    error = np.sqrt(share / motion.samples(cutoff_hz)) / (2.0 * np.pi * cutoff_hz / np.sqrt(3.0))
    return seconds, float(error)


def _shared_lag(
    motion: Motion, cutoff_hz: float, reading: Reading, axes: Sequence[Agreement], lag_s: float
) -> float:
    """The lag [s] of the axis that is nearest to the pose; 0 if axes are on both sides of it.

    A clock that is apart delays all axes alike, a filter some more than others. `lag_s` is what
    the velocities of the motion have been shifted by.
    """
    own = [
        lag_s + _lag(motion, cutoff_hz, reading, (axis,))[0]
        for axis in axes
        if axis.excited and abs(axis.correlation) > SURE
    ]
    if not own or min(own) < 0.0 < max(own):
        return 0.0
    return min(own, key=abs)


def _accelerations(
    motion: Motion, cutoff_hz: float, measured: Sequence[str]
) -> tuple[Agreement, ...]:
    """Agreement of the recorded accelerations with the derivative of the velocities."""
    dofs = [dof for dof in motion.dofs if dof in measured]
    if not dofs:
        return ()
    recording, index = motion.recording, [motion.dofs.index(dof) for dof in dofs]
    observed = motion.inside(recording.nu_dot[:, index], cutoff_hz)
    expected = motion.inside(motion.derivative(recording.nu[:, index]), cutoff_hz)
    rho = np.diag(correlations(observed, expected))
    return tuple(
        Agreement(
            dof, dof, float(rho[i]), scale_of(observed[:, i], expected[:, i], float(rho[i])),
            motion.accelerates(dof, observed[:, i], expected[:, i], cutoff_hz),
        )
        for i, dof in enumerate(dofs)
    )  # fmt: skip
