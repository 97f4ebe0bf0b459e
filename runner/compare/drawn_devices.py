"""Thrust and rudders of a run as line segments in the vessel's plane, for its animation.

Body x is ahead and y to starboard, both in metres from amidships. A thrust is an arrow whose length
is relative to its limit or largest value; a rudder is a blade behind the stern, to the side to
which the ship turns.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from seatrial.runner.compare.plots.force_units import largest_of
from seatrial.runner.compare.statistics import Sample
from seatrial.runner.database.records import Series
from seatrial.runner.vocabulary import Config

Kind = Literal["thrust", "moment", "rudder"]
STERN = -0.5  # [L]
BLADE = 0.16  # length of a rudder [L], longer than a real one, to be seen
LONGEST = {"thrust": 0.8, "moment": 0.6}  # length of an arrow at the limit [L]
DRIVES = ("drive", "n")  # options of a device that name the input of its thrust


@dataclass(frozen=True, eq=False)
class Part:
    """A device over time: `start` and `end` are points of the body [m], shape (n, 2)."""

    name: str
    kind: Kind
    start: Sample
    end: Sample

    def in_plane(self, north: float, east: float, psi: float, frame: int) -> Sample:
        """Return (east, north) of both ends at a frame and pose, shape (2, 2) [m]."""
        ahead, side = np.array([self.start[frame], self.end[frame]]).T
        easts = east + np.sin(psi) * ahead + np.cos(psi) * side
        return np.column_stack([easts, north + np.cos(psi) * ahead - np.sin(psi) * side])


def parts_of(series_of: Sequence[Series], vessel: Config, length: float) -> list[list[Part]]:
    """Return the devices of each series; those of all have one scale.

    `vessel` is the stored configuration, `length` that of the drawn hull [m].
    """
    if any(name.startswith("tau_") for name in series_of[0].columns):
        return [list(_forces(series, series_of, length)) for series in series_of]
    return [list(_inputs(series, vessel, length)) for series in series_of]


def _forces(series: Series, series_of: Sequence[Series], length: float) -> Iterator[Part]:
    """The total force from amidships, and the moment as a side force at the bow."""
    largest = {
        name: largest_of([s.columns[name] for s in series_of if name in s.columns]) or 1.0
        for name in ("tau_surge", "tau_sway", "tau_yaw")
    }
    zero = np.zeros(len(series.columns["t"]))
    surge, sway, yaw = (np.asarray(series.columns.get(name, zero)) for name in largest)
    size = LONGEST["thrust"] * length / max(largest["tau_surge"], largest["tau_sway"])
    yield Part("force", "thrust", _points(zero, zero), _points(size * surge, size * sway))
    if "tau_yaw" in series.columns:
        bow = np.full_like(zero, 0.5 * length)
        side = LONGEST["moment"] * length / largest["tau_yaw"] * yaw
        yield Part("moment", "moment", _points(bow, zero), _points(bow, side))


def _inputs(series: Series, vessel: Config, length: float) -> Iterator[Part]:
    """Rudders, and the thrust of propellers and thrusters where they are."""
    inputs, devices = vessel.get("inputs") or {}, vessel.get("devices") or {}
    scale = length / float(vessel.get("length_m") or length)  # of hulls that are drawn larger
    for name, limits in inputs.items():
        if name not in series.columns or name.startswith("alpha"):
            continue
        device = _device_of(name, devices)
        if name.startswith("delta"):
            if device.get("kind") != "plane" and not name.endswith("_s"):
                yield _rudder(name, series, length)
            continue
        high = max(abs(float(limits.get(end) or 0.0)) for end in ("low", "high")) or 1.0
        yield _thrust(name, series, device, scale, length, high)


def _device_of(name: str, devices: Config) -> Config:
    """Return the options of the device that an input drives; empty if none names it."""
    options = [device for device in devices.values() if isinstance(device, Mapping)]
    return next((d for d in options if name in (d.get(k) for k in (*DRIVES, "delta"))), {})


def _thrust(
    name: str, series: Series, device: Config, scale: float, length: float, high: float
) -> Part:
    share = np.asarray(series.columns[name], dtype=np.float64) / high
    fixed = np.full_like(share, float(device.get("angle_rad") or 0.0))
    angle = np.asarray(series.columns.get(str(device.get("alpha")), fixed))
    x = scale * float(device["x_m"]) if "x_m" in device else STERN * length
    y = scale * float(device.get("y_m") or 0.0)
    start = _points(np.full_like(share, x), np.full_like(share, y))
    arrow = LONGEST["thrust"] * length * _points(share * np.cos(angle), share * np.sin(angle))
    return Part(name, "thrust", start, start + arrow)


def _rudder(name: str, series: Series, length: float) -> Part:
    angle = np.asarray(series.columns[name], dtype=np.float64)
    side = turning_side(series, angle)
    stock = _points(np.full_like(angle, STERN * length), np.zeros_like(angle))
    blade = BLADE * length * _points(-np.cos(angle), side * np.sin(angle))
    return Part(name, "rudder", stock, stock + blade)


def turning_side(series: Series, helm: Sample) -> float:
    """Return 1.0 if a positive helm [rad] turns the ship to starboard, else -1.0.

    It is the sign of b of `r_dot = a r + b helm`, fitted by least squares: conventions differ.
    """
    t = series.columns["t"]
    rate = series.columns.get("r")
    rate = np.gradient(np.unwrap(series.columns["psi"]), t) if rate is None else np.asarray(rate)
    regressors = np.column_stack([rate, helm])
    solution = np.linalg.lstsq(regressors, np.gradient(rate, t), rcond=None)[0]
    return -1.0 if solution[1] < 0.0 else 1.0


def _points(x: Sample, y: Sample) -> Sample:
    return np.column_stack([x, y])
