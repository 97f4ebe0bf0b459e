"""What an animation of a run shows: each voyage at its frames, with the devices of the vessel."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.drawn_devices import Part, parts_of
from seatrial.runner.compare.plots.hull import drawn_length
from seatrial.runner.compare.plots.request import PlotRequest, subtitle
from seatrial.runner.compare.plots.sailed_missions import voyages
from seatrial.runner.compare.plots.style import MODEL_COLOURS
from seatrial.runner.compare.results import Results
from seatrial.runner.compare.statistics import Sample
from seatrial.runner.database.records import Series

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
