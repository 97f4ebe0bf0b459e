"""netCDF files, such as those of gliders: a source the variables of a dimension, by xarray."""

import re
from pathlib import Path

import xarray as xr

from seatrial.models.errors import RecordingError
from seatrial.models.recording.formats.mat_file import sources_of_arrays
from seatrial.models.recording.source import LARGEST_BYTES, ReadOptions, Source, foreign

EXPECTED = "a netCDF file"


def read(path: Path, options: ReadOptions) -> list[Source]:
    """The variables of a file, times as date-times; raises RecordingError if it cannot be read."""
    leaves: list[tuple[str, str, object]] = []
    units: dict[str, str] = {}
    with foreign(path, EXPECTED), xr.open_dataset(path, decode_timedelta=False) as stored:
        if (size := sum(8 * variable.size for variable in stored.variables.values())) > LARGEST_BYTES:
            raise RecordingError(f"{path}: got {size / 1e6:.3g} MB of numbers, cut the recording")
        sizes = {str(name): size for name, size in stored.sizes.items()}
        for key, variable in stored.variables.items():
            values = variable.values
            if values.dtype.kind in "MOSU":  # date-times, also of other calendars, and text
                texts = values.astype("datetime64[us]" if values.dtype.kind == "M" else "U")
                values = texts.astype("U").astype(object)
                values[values == "NaT"] = ""
            elif unit := re.sub(r"(?<=[A-Za-z])(-?\d)", r"**\1", str(variable.attrs.get("units", ""))):
                units[str(key)] = re.sub(r"^degrees?_?(north|east|[NE])?$", "deg", unit)
            long = [str(name) for name in variable.dims if sizes[str(name)] > 1]
            group = max(long, key=sizes.__getitem__, default="")
            leaves.append((group, str(key), values))
    groups = {group for group, _, _ in leaves if group}
    named = [("" if len(groups) == 1 else group, key, values) for group, key, values in leaves]
    return sources_of_arrays(path, named, units, EXPECTED)
