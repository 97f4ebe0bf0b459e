"""What an animation of a run shows: each voyage at its frames, with the devices of the vessel.

Thrust and rudders are line segments in the plane of the body, x ahead and y to starboard, both in
metres from amidships. A thrust is an arrow whose length is relative to its limit or largest value;
a rudder is a blade behind the stern, to the side to which the ship turns.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.plots.force_units import largest_of
from seatrial.runner.compare.plots.hull import drawn_length
from seatrial.runner.compare.plots.request import PlotRequest, subtitle
from seatrial.runner.compare.plots.sailed_missions import voyages
from seatrial.runner.compare.plots.style import MODEL_COLOURS
from seatrial.runner.compare.results import Results
from seatrial.runner.compare.statistics import Sample
from seatrial.runner.record.rows import Series
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


MARGIN = 0.08  # of the extent of the track, beside the room of a hull


@dataclass(frozen=True, eq=False)
class Sail:
    """A voyage at the frames of the animation: each signal has shape (n,), [m], [rad], [s]."""

    name: str
    colour: str
    t: Sample
    north: Sample
    east: Sample
    psi: Sample
    reference: Sample | None  # (east, north), shape (n, 2)
    parts: Sequence[Part]


@dataclass(frozen=True, eq=False)
class Scene:
    """What is animated: the voyages, the length of the hulls [m], and the limits of the plane."""

    title: str
    sails: Sequence[Sail]
    length: float
    north: tuple[float, float]
    east: tuple[float, float]
    notes: Sequence[str]


def scene_of(results: Results, number: int, most: int) -> Scene:
    """Return what the animation of a run shows, in at most so many frames."""
    config = results.reader.run(number).config  # that there is one
    ((run, series_of),) = voyages(results, PlotRequest(run=number), "animate", "recording")
    for kind, series in series_of.items():
        if "psi" not in series.columns:
            raise ConfigurationError(f"animate: run {number} has no heading psi in {kind}")
    extent = max(
        float(np.ptp(series.columns[name])) for series in series_of.values() for name in ("x", "y")
    )
    length, note = drawn_length(config, extent)
    frames = {name: _frames(series, most) for name, series in series_of.items()}
    shown = {name: _cut(series, frames[name]) for name, series in series_of.items()}
    vessel = config.get("vessel")
    devices = parts_of(list(shown.values()), vessel if isinstance(vessel, Mapping) else {}, length)
    sails = [
        _sail(name, series, parts)
        for (name, series), parts in zip(shown.items(), devices, strict=True)
    ]
    kinds = {part.kind for sail in sails for part in sail.parts}
    notes = [note, "lines from the hull: thrust, relative to the largest or its limit"]
    notes += ["rudder longer than it is"] if "rudder" in kinds else []
    notes += ["the identified model sails the same track"] if [*shown] == ["nominal"] else []
    north, east = _limits(sails, 1, length), _limits(sails, 0, length)
    title = f"Run {subtitle(run).removeprefix('run ')}"
    return Scene(title, sails, length, north, east, notes)


def _frames(series: Series, most: int) -> Sample:
    count = len(series.columns["t"])
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))


def _cut(series: Series, frames: Sample) -> Series:
    columns = {name: np.asarray(values)[frames] for name, values in series.columns.items()}
    return Series(series.kind, columns, series.units)


def _sail(name: str, series: Series, parts: Sequence[Part]) -> Sail:
    columns = series.columns
    reference = None
    if "x_d" in columns:
        reference = np.column_stack([columns["y_d"], columns["x_d"]])
    label = "recording" if name == "recording" else f"{name} model"
    return Sail(
        label, MODEL_COLOURS[name], columns["t"], columns["x"], columns["y"], columns["psi"],
        reference, parts,
    )  # fmt: skip


def _limits(sails: Sequence[Sail], axis: int, length: float) -> tuple[float, float]:
    """Return the limits of east (axis 0) or north (axis 1) [m], equal for all voyages."""
    values = [sail.east if axis == 0 else sail.north for sail in sails]
    values += [sail.reference[:, axis] for sail in sails if sail.reference is not None]
    joined = np.concatenate(values)
    low, high = float(np.nanmin(joined)), float(np.nanmax(joined))
    room = MARGIN * (high - low) + 0.7 * length
    return low - room, high + room
