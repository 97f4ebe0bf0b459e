"""Measures of a stop and of a Williamson turn.

Lengths are in ship lengths, from the position and along the course at the order.
Source: IMO MSC/Circ.1053, sections 2.3 and 3.
"""

from typing import NamedTuple

import numpy as np

from seatrial.models.simulation.manoeuvre_measures import (
    Execution,
    Track,
    crossing,
    executions,
    path_length,
    way_from,
)


class Stop(NamedTuple):
    """Measures of a stop; NaN if the ship does not come to rest."""

    execute_s: float
    head_reach: float  # along the course of the approach
    track_reach: float  # along the path
    deviation: float  # across the course, positive to starboard
    time_s: float  # from the order until the ship does not move ahead
    heading_change_deg: float


class Williamson(NamedTuple):
    """Measures of a Williamson turn at its end."""

    execute_s: float
    offset: float  # across the track of the approach, positive to starboard of it
    heading_error_deg: float  # from the reciprocal of the course
    widest: float  # largest distance from the track


def stop(track: Track, kind: Execution = "half") -> Stop:
    """Measures of a stop; the helm of the track is the order of the engine."""
    start = float(executions(track, kind)[0])
    velocity = [np.gradient(way, track.t) for way in (track.north, track.east)]
    ahead = np.cos(track.psi) * velocity[0] + np.sin(track.psi) * velocity[1]
    still = np.flatnonzero((track.t > start) & (ahead <= 0.0))
    if not len(still):
        return Stop(start, *[np.nan] * 5)
    end = crossing(track.t, ahead, int(still[0]))
    course, over = track.at(track.psi, start), 1.0 / track.length_m
    along, aside = way_from(track, start, course)
    return Stop(
        start, over * track.at(along, end), over * path_length(track, start, end),
        over * track.at(aside, end), end - start,
        float(np.degrees(track.at(track.psi, end) - course)),
    )  # fmt: skip


def williamson(track: Track, kind: Execution = "half") -> Williamson:
    """Measures of a Williamson turn."""
    start = float(executions(track, kind)[0])
    course, over = track.at(track.psi, start), 1.0 / track.length_m
    _, aside = way_from(track, start, course)
    error = np.angle(np.exp(1j * (track.psi[-1] - course - np.pi)))
    return Williamson(
        start, over * float(aside[-1]), float(np.degrees(error)),
        over * float(np.max(np.abs(aside))),
    )  # fmt: skip
