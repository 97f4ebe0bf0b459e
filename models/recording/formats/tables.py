"""Tables and arrays: Excel, a source a sheet, Parquet, MATLAB 5 and 7.3 (HDF5), and netCDF."""

import re
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from textwrap import shorten
from typing import Any

import numpy as np
import pandas as pd
import scipy
from pyarrow import parquet

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.recording.formats.text import column_of_cells, table
from seatrial.models.recording.source import (
    MOST_ELEMENTS,
    Contents,
    ReadOptions,
    Source,
    Values,
    check_size,
    table_source,
)

HDF5 = b"\x89HDF\r\n\x1a\n"
NUMERIC = ("double", "single", "logical", "cell", "struct", "char")  # and int8 ... uint64


def read_excel(path: Path, options: ReadOptions) -> Contents:
    """The sheets of a workbook, read like the text that their cells would be."""
    sources, left_out = [], []
    text = replace(options.text, separator=",", decimal=".", encoding=None, comment=None)
    book = pd.read_excel(path, sheet_name=None, header=None, keep_default_na=False)
    for name, sheet in book.items():
        try:
            cells = sheet.to_csv(header=False, index=False).encode()
            sources.append(table(path, cells, text, name))
        except RecordingError as error:
            left_out.append(f"sheet {name}: {str(error).removeprefix(f'{path}: ')}")
    return sources, left_out


def read_parquet(path: Path, options: ReadOptions) -> Contents:
    """The columns of a Parquet file, date-times as text, units from the metadata of fields."""
    with parquet.ParquetFile(path) as file:
        check_size(path, file.metadata.num_rows * file.metadata.num_columns)
        stored = file.read(use_threads=False)
    frame = stored.to_pandas(ignore_metadata=True)
    titles = ["index" if name == "__index_level_0__" else name for name in stored.column_names]
    units = [(field.metadata or {}).get(b"unit", b"").decode() for field in stored.schema]
    columns = [_column(frame.iloc[:, i]) for i in range(len(titles))]
    return [table_source(path.stem, path, titles, columns, units)], []


def _column(values: "pd.Series[Any]") -> Values:
    """A column as numbers, NaN for null, or as text, shape (N,)."""
    if pd.api.types.is_numeric_dtype(values):
        return np.asarray(values.to_numpy(np.float64, na_value=np.nan))
    return column_of_cells(values.astype(str).mask(values.isna(), "").to_list())[0]


def read_matlab(path: Path, options: ReadOptions) -> Contents:
    """The variables of a MATLAB file."""
    with path.open("rb") as file:
        head = file.read(520)
    variables: dict[str, object] = {}
    if HDF5 in (head[:8], head[512:]):
        if find_spec("h5py") is None:
            raise ConfigurationError(
                f"{path}: is a MATLAB 7.3 file: h5py is not installed: pip install 'seatrial[mat]'"
            )
        import h5py

        with h5py.File(path, "r") as stored:
            variables = {n: _plain(v, stored) for n, v in stored.items() if n[0] != "#"}
    else:
        read = scipy.io.loadmat(path, struct_as_record=False, squeeze_me=True)
        for name, value in read.items():
            if isinstance(value, scipy.io.matlab.MatlabOpaque):  # its own name is lost
                name = value["s0"].item().decode()
            if not name.startswith("__"):
                variables[name] = _plain(value)
    leaves = [leaf for name, value in variables.items() for leaf in _leaves("", name, value)]
    return _sources(path, leaves, {}, {})


def read_netcdf(path: Path, options: ReadOptions) -> Contents:
    """The variables of a file, a source a dimension, times as date-times."""
    import xarray as xr

    leaves: list[tuple[str, str, object]] = []
    units, titles = dict[str, str](), dict[str, str]()
    with xr.open_dataset(path, decode_timedelta=False) as stored:
        for key, variable in stored.variables.items():
            values = np.atleast_1d(variable.values)
            titles[str(key)] = str(variable.attrs.get("long_name", key))
            if values.dtype.kind in "MOSU":  # date-times, also of other calendars, and text
                values = _column(pd.Series(values.ravel()))
            elif unit := str(variable.attrs.get("units", "")):  # by UDUNITS: m s-1, degrees_north
                unit = re.sub(r"(?<=[A-Za-z])(-?\d)", r"**\1", unit)
                units[str(key)] = re.sub(r"^degrees?_?(north|east|[NE])?( \(.*)?$", "deg", unit)
            long = {str(name): size for name, size in variable.sizes.items() if size > 1}
            leaves.append((max(long, key=lambda name: long[name], default=""), str(key), values))
    if len({group for group, _, _ in leaves if group}) == 1:
        leaves = [("", key, values) for _, key, values in leaves]
    return _sources(path, leaves, units, titles)


def _sources(
    path: Path, leaves: list[tuple[str, str, object]], units: Mapping[str, str],
    titles: Mapping[str, str],
) -> Contents:  # fmt: skip
    """Vectors and matrices with a row or column a sample, by source and name, as sources.

    Those of equal length share a clock: the variables of a file, and the fields of one struct.
    Columns of a matrix are named `name[0]`, `name[1]` ...; what is neither is named as left out.
    """
    groups: dict[tuple[str, int], dict[str, Values]] = defaultdict(dict)
    lost: dict[str, list[str]] = defaultdict(list)
    for top, name, value in leaves:
        values = np.squeeze(value) if isinstance(value, np.ndarray) else np.zeros(())
        text = values.dtype == np.object_
        values = values if text else values.astype(np.float64)
        if values.ndim == 1 and len(values) > 1:
            groups[top, len(values)][name] = values
        elif values.ndim == 2 and min(values.shape) <= MOST_ELEMENTS and not text:
            rows = values.T if values.shape[0] > values.shape[1] else values
            groups[top, rows.shape[1]] |= {f"{name}[{i}]": row for i, row in enumerate(rows)}
        else:
            shape = " x ".join(map(str, values.shape))
            kind = "single values" if values.size <= 1 else f"arrays of {shape}"
            kind = "text" if text else kind if isinstance(value, np.ndarray) else str(value)
            lost[kind].append(f"{top}.{name}" if top else name)
    sources: dict[str, Source] = {}
    for (top, size), columns in sorted(groups.items(), key=lambda item: -len(item[1])):
        name = top or path.stem
        name = f"{name}/{size}" if name in sources else name
        known, written = ({n: of[n] for n in columns if n in of} for of in (units, titles))
        sources[name] = Source(name, path, columns, known, written)
    return list(sources.values()), [
        f"{shorten(', '.join(names), 200, placeholder=' ...')}: {kind}, no columns"
        for kind, names in lost.items()
    ]


def _leaves(top: str, name: str, value: object) -> Iterator[tuple[str, str, object]]:
    """The arrays of a variable by source and name: a struct and each cell is a source.

    Cells or structs of single numbers or texts are the rows of one source.
    """
    if isinstance(value, dict):
        for field, inner in value.items():
            place = (top, f"{name}.{field}") if top and name else (top or name, field)
            yield from _leaves(place[0], place[1], inner)
    elif isinstance(value, list):
        base = "/".join(part for part in (top, *name.split(".")) if part)
        rows = [list(_leaves("", "", element)) for element in value]
        single = [
            {n: v.item() for _, n, v in row if isinstance(v, np.ndarray) and v.size == 1}
            for row in rows
        ]
        if len(rows) > 1 and list(map(len, single)) == list(map(len, rows)):
            for field in dict.fromkeys(key for found in single for key in found):
                cells = [found.get(field, np.nan) for found in single]
                kind = object if any(isinstance(cell, str) for cell in cells) else None
                place = (base, field) if field else (top, name)
                yield *place, np.array(cells, dtype=kind)
            return
        for number, element in enumerate(value, 1):
            own = "" if isinstance(element, dict | list) else base.rpartition("/")[2]
            yield from _leaves(f"{base}/{number}", own, element)
    else:
        yield top, name, value


def _plain(value: Any, stored: Any = None) -> object:
    """A variable as dictionaries, lists and arrays; a text says what else it is.

    Args:
        value: as scipy reads it, or a part of the HDF5 file `stored`.
    """
    if stored is None:
        if isinstance(value, scipy.io.matlab.MatlabOpaque):
            return f"objects of class {value['s2'].item().decode()}"
        if isinstance(value, scipy.io.matlab.mat_struct):
            return {field: _plain(getattr(value, field)) for field in value._fieldnames}
        array = np.asarray(value)
        if array.dtype == np.object_:
            return [_plain(element) for element in array.ravel()]
        if array.dtype.kind == "U":
            return array.astype(object)
        return array if array.dtype.kind in "biuf" else f"values of {array.dtype.name}"
    kind = value.attrs.get("MATLAB_class", b"double").decode()
    if "MATLAB_object_decode" in value.attrs or not (kind in NUMERIC or "int" in kind):
        return f"objects of class {kind}"
    if hasattr(value, "items"):
        fields = {name: _plain(inner, stored) for name, inner in value.items()}
        cells = all("MATLAB_class" in value[name].attrs for name in fields)
        sizes = {len(f) if isinstance(f, list) and not cells else 0 for f in fields.values()}
        if len(sizes) == 1 and (size := sizes.pop()):  # an array of structs
            return [{k: v[i] for k, v in fields.items()} for i in range(size)]  # type: ignore[index]
        return fields
    if value.dtype.hasobject:
        return [_plain(stored[reference], stored) for reference in value[()].T.ravel()]
    if "MATLAB_empty" in value.attrs:
        return "empty arrays"
    if kind == "char":  # a row of characters a text
        return np.squeeze(np.array(["".join(map(chr, row)) for row in value[()].T], dtype=object))
    return value[()] if value.dtype.kind in "biuf" else f"values of {value.dtype}"
