"""Tables and arrays: Excel, a source a sheet, Parquet, MATLAB 5 and 7.3 (HDF5), and netCDF."""

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from textwrap import shorten
from typing import Any

import numpy as np
import pandas as pd
import scipy
from pyarrow import parquet

from seatrial.models.errors import RecordingError
from seatrial.models.recording.formats.text import table, table_source
from seatrial.models.recording.source import MOST_ELEMENTS, Contents, ReadOptions, check_size


def read_excel(path: Path, options: ReadOptions) -> Contents:
    """The sheets of a workbook, read like the text that their cells would be."""
    sources, left_out = [], []
    text = replace(options.text, separator=",", decimal=".", encoding=None, comment=None)
    options = replace(options, text=text)
    book = pd.read_excel(path, sheet_name=None, header=None, keep_default_na=False)
    for name, sheet in book.items():
        try:
            data = sheet.to_csv(header=False, index=False).encode()
            sources.append(table(path, data, options, name))
        except RecordingError as error:
            left_out.append(f"sheet {name}: {str(error).removeprefix(f'{path}: ')}")
    return sources, left_out


def read_parquet(path: Path, options: ReadOptions) -> Contents:
    """The columns of a Parquet file, date-times as text, units from the metadata of fields."""
    with parquet.ParquetFile(path) as file:
        check_size(path, 8 * file.metadata.num_rows * file.metadata.num_columns)
        stored = file.read(use_threads=False)
    frame = stored.to_pandas(ignore_metadata=True)
    names = ("index" if name == "__index_level_0__" else name for name in stored.column_names)
    units = ((field.metadata or {}).get(b"unit", b"").decode() for field in stored.schema)
    columns = zip(names, (cells for _, cells in frame.items()), units, strict=True)
    return [table_source(path.stem, path, columns)], []


def read_matlab(path: Path, options: ReadOptions) -> Contents:
    """The variables of a file of MATLAB 5 to 7."""
    variables = dict[str, object]()
    read = scipy.io.loadmat(path, struct_as_record=False, squeeze_me=True)
    for name, value in read.items():
        if isinstance(value, scipy.io.matlab.MatlabOpaque):  # its own name is lost
            name = value["s0"].item().decode()
        if not name.startswith("__"):
            variables[name] = _of_scipy(value)
    return _sources(path, _placed(variables))


def read_hdf5(path: Path, options: ReadOptions) -> Contents:
    """The variables of a file of MATLAB 7.3, or another of HDF5."""
    import h5py

    with h5py.File(path, "r") as stored:
        variables = {n: _of_hdf5(v, stored) for n, v in stored.items() if n[0] != "#"}
    return _sources(path, _placed(variables))


def read_netcdf(path: Path, options: ReadOptions) -> Contents:
    """The variables of a file, a source a dimension, times as date-times."""
    import xarray as xr

    leaves = list[tuple[str, str, Any, str]]()
    with xr.open_dataset(path, decode_timedelta=False) as stored:
        for name, variable in stored.squeeze().variables.items():
            unit = re.sub(r"(?<=[A-Za-z])(-?\d)", r"**\1", str(variable.attrs.get("units", "")))
            longest = max(variable.sizes, key=variable.sizes.__getitem__, default="")
            leaves.append((str(longest), str(name), variable.values, unit))  # UDUNITS: m s-1
    return _sources(path, leaves)


def _sources(path: Path, leaves: Iterable[tuple[str, str, Any, str]]) -> Contents:
    """Vectors and matrices with a row or column a sample, by source, name and unit, as sources.

    Those of equal length share a clock: the variables of a file, and the fields of one struct.
    Columns of a matrix are named `name[0]`, `name[1]` ...; what is neither is named as left out.
    """
    groups: dict[tuple[str, int], list[tuple[str, Any, str]]] = defaultdict(list)
    lost: dict[str, list[str]] = defaultdict(list)
    for top, name, value, unit in leaves:
        values = np.squeeze(value) if isinstance(value, np.ndarray) else np.zeros(())
        text, number = values.dtype.kind in "MOU", values.dtype.kind in "biuf"
        if values.ndim == 1 and len(values) > 1 and (text or number):
            groups[top, len(values)].append((name, values, unit))
        elif number and values.ndim == 2 and min(values.shape) <= MOST_ELEMENTS:
            rows = values.T if values.shape[0] > values.shape[1] else values
            group = groups[top, rows.shape[1]]
            group += [(f"{name}[{i}]", row, unit) for i, row in enumerate(rows)]
        else:
            kind = f"{values.dtype} of shape {values.shape}"
            kind = value if isinstance(value, str) else "text" if text else kind
            lost[kind].append(f"{top}.{name}" if top else name)
    each = sorted(groups.items(), key=lambda item: -len(item[1]))
    sources = [table_source(top or path.stem, path, columns) for (top, _), columns in each]
    return sources, [f"{shorten(', '.join(names), 200, placeholder=' ...')}: {kind}, no columns"
                     for kind, names in lost.items()]  # fmt: skip


def _placed(value: Any, place: tuple[str | int, ...] = ()) -> Iterator[tuple[str, str, Any, str]]:
    """The arrays of variables by source and name: a struct and each cell is a source.

    `place` are the names of fields and the numbers of cells on the way to the value.
    """
    value = _rows(value) if isinstance(value, list) else value
    if isinstance(value, dict | list):
        for key, inner in value.items() if isinstance(value, dict) else enumerate(value, 1):
            yield from _placed(inner, (*place, key))
    else:
        cells = [k for k, key in enumerate(place) if isinstance(key, int)]
        own = cells[-1] + 1 if cells else int(len(place) > 1)  # the rest is the name
        named = place[own:] or [key for key in place if isinstance(key, str)][-1:]
        yield "/".join(map(str, place[:own])), ".".join(map(str, named)), value, ""


def _rows(cells: list[Any]) -> object:
    """Cells, or an array of structs, of single numbers or texts as columns, else as they are."""
    rows = [{name: leaf for _, name, leaf, _ in _placed(cell, ("",))} for cell in cells]
    leaves = [leaf for row in rows for leaf in row.values()]
    if len(rows) < 2 or not all(isinstance(leaf, np.ndarray) and leaf.size == 1 for leaf in leaves):
        return cells
    frame = pd.DataFrame([{name: leaf.item() for name, leaf in row.items()} for row in rows])
    columns = {str(name): values.to_numpy() for name, values in frame.items()}
    return columns[""] if list(columns) == [""] else columns


def _of_scipy(value: Any) -> object:
    """A variable as dictionaries, lists and arrays; a text says what else it is."""
    if isinstance(value, scipy.io.matlab.MatlabOpaque):
        return f"objects of class {value['s2'].item().decode()}"
    if isinstance(value, scipy.io.matlab.mat_struct):
        return {field: _of_scipy(getattr(value, field)) for field in value._fieldnames}
    array = np.asarray(value)
    return [_of_scipy(element) for element in array.ravel()] if array.dtype.hasobject else array


def _of_hdf5(value: Any, stored: Any) -> object:
    """The same of a part of an HDF5 file."""
    kind = value.attrs.get("MATLAB_class", b"").decode()
    if "MATLAB_object_decode" in value.attrs:
        return f"objects of class {kind}"
    if hasattr(value, "items"):
        fields: dict[str, Any] = {name: _of_hdf5(inner, stored) for name, inner in value.items()}
        sizes = {len(f) if isinstance(f, list) else 0 for f in fields.values()}
        if len(sizes) == 1 and (size := sizes.pop()):  # an array of structs
            return [{k: v[i] for k, v in fields.items()} for i in range(size)]
        return fields
    if value.dtype.hasobject:
        return [_of_hdf5(stored[reference], stored) for reference in value[()].T.ravel()]
    if "MATLAB_empty" in value.attrs:
        return "empty arrays"
    if kind == "char":  # a row of characters a text
        return np.squeeze(np.array(["".join(map(chr, row)) for row in value[()].T], dtype=object))
    return value[()]
