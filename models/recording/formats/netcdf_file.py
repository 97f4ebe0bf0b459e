"""netCDF files, such as those of gliders: a source the variables of a dimension, by xarray."""

import re
from pathlib import Path

import numpy as np
import xarray as xr

from seatrial.models.recording.formats.mat_file import sources_of_arrays
from seatrial.models.recording.source import ReadOptions, Source, check_size, foreign

EXPECTED = "a netCDF file"


def read(path: Path, options: ReadOptions) -> list[Source]:
    """The variables of a file, times as date-times; raises RecordingError if it cannot be read."""
    leaves: list[tuple[str, str, object]] = []
    units: dict[str, str] = {}
    with foreign(path, EXPECTED), xr.open_dataset(path, decode_timedelta=False) as stored:
        check_size(path, sum(variable.size for variable in stored.variables.values()))
        sizes = {str(name): size for name, size in stored.sizes.items()}
        for key, variable in stored.variables.items():
            values = np.atleast_1d(variable.values)
            if values.dtype.kind in "MOSU":  # date-times, also of other calendars, and text
                texts = values.astype("datetime64[us]" if values.dtype.kind == "M" else "U")
                values = texts.astype("U").astype(object)
                values[values == "NaT"] = ""
            elif unit := str(variable.attrs.get("units", "")):  # by UDUNITS: m s-1, degrees_north
                unit = re.sub(r"(?<=[A-Za-z])(-?\d)", r"**\1", unit)
                units[str(key)] = re.sub(r"^degrees?_?(north|east|[NE])?$", "deg", unit)
            long = [str(name) for name in variable.dims if sizes[str(name)] > 1]
            group = max(long, key=sizes.__getitem__, default="")
            leaves.append((group, str(key), values))
    groups = {group for group, _, _ in leaves if group}
    named = [("" if len(groups) == 1 else group, key, values) for group, key, values in leaves]
    return sources_of_arrays(path, named, units, EXPECTED)
