"""Tables and arrays: Excel, a source a sheet, Parquet, MATLAB 5 and 7.3 (HDF5), and netCDF."""

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from textwrap import shorten
from typing import Any

import numpy as np
import pandas as pd
import scipy
from pyarrow import parquet

from seatrial.models.errors import RecordingError
from seatrial.models.recording.formats.columns import Cells, column_of_cells, table_source
from seatrial.models.recording.formats.text import table
from seatrial.models.recording.source import (
    MOST_ELEMENTS,
    Contents,
    ReadOptions,
    Source,
    Values,
    check_size,
)


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
    columns = (
        ("index" if field.name == "__index_level_0__" else field.name, _cells(frame.iloc[:, i]),
         (field.metadata or {}).get(b"unit", b"").decode())
        for i, field in enumerate(stored.schema)
    )  # fmt: skip
    return [table_source(path.stem, path, columns)], []


def _cells(values: "pd.Series[Any]") -> Cells:
    """A column as numbers, NaN for null, or as text, shape (N,)."""
    if pd.api.types.is_numeric_dtype(values):
        return np.asarray(values.to_numpy(np.float64, na_value=np.nan))
    return values.astype(str).mask(values.isna(), "").to_list()


def read_matlab(path: Path, options: ReadOptions) -> Contents:
    """The variables of a file of MATLAB 5 to 7."""
    variables = dict[str, object]()
    read = scipy.io.loadmat(path, struct_as_record=False, squeeze_me=True)
    for name, value in read.items():
        if isinstance(value, scipy.io.matlab.MatlabOpaque):  # its own name is lost
            name = value["s0"].item().decode()
        if not name.startswith("__"):
            variables[name] = _of_scipy(value)
    return _sources(path, _leaves("", "", variables), {}, {})


def read_hdf5(path: Path, options: ReadOptions) -> Contents:
    """The variables of a file of MATLAB 7.3, or another of HDF5."""
    import h5py

    with h5py.File(path, "r") as stored:
        variables = {n: _of_hdf5(v, stored) for n, v in stored.items() if n[0] != "#"}
    return _sources(path, _leaves("", "", variables), {}, {})


def read_netcdf(path: Path, options: ReadOptions) -> Contents:
    """The variables of a file, a source a dimension, times as date-times."""
    import xarray as xr

    leaves: list[tuple[str, str, object]] = []
    units, titles = dict[str, str](), dict[str, str]()
    with xr.open_dataset(path, decode_timedelta=False) as stored:
        for key, variable in stored.variables.items():
            values, name = np.atleast_1d(variable.values), str(key)
            titles[name] = str(variable.attrs.get("long_name", key))
            if values.dtype.kind in "MOSU":  # date-times, also of other calendars, and text
                values = column_of_cells(_cells(pd.Series(values.ravel())))[0]
            else:  # by UDUNITS: m s-1
                unit = str(variable.attrs.get("units", ""))
                units[name] = re.sub(r"(?<=[A-Za-z])(-?\d)", r"**\1", unit)
            long = {str(name): size for name, size in variable.sizes.items() if size > 1}
            leaves.append((max(long, key=lambda name: long[name], default=""), name, values))
    if len({group for group, _, _ in leaves if group}) == 1:
        leaves = [("", name, values) for _, name, values in leaves]
    return _sources(path, leaves, units, titles)


def _sources(
    path: Path, leaves: Iterable[tuple[str, str, object]], units: Mapping[str, str],
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
        text, number = values.dtype.kind in "OU", values.dtype.kind in "biuf"
        if values.ndim == 1 and len(values) > 1 and (text or number):
            groups[top, len(values)][name] = values.astype(object) if text else values
        elif number and values.ndim == 2 and min(values.shape) <= MOST_ELEMENTS:
            rows = values.T if values.shape[0] > values.shape[1] else values
            groups[top, rows.shape[1]] |= {f"{name}[{i}]": row for i, row in enumerate(rows)}
        else:
            shape = " x ".join(map(str, values.shape))
            kind = f"arrays of {shape} {values.dtype}" if shape else "single values"
            kind = value if isinstance(value, str) else "text" if text else kind
            lost[kind].append(f"{top}.{name}" if top else name)
    sources: dict[str, Source] = {}
    for (top, size), columns in sorted(groups.items(), key=lambda item: -len(item[1])):
        name = top or path.stem
        name = f"{name}/{size}" if name in sources else name
        triples = [(title, cells, units.get(title, "")) for title, cells in columns.items()]
        written = {title: titles[title] for title in columns if title in titles}
        sources[name] = replace(table_source(name, path, triples), titles=written)
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
        base = "/".join(filter(None, (top, *name.split("."))))
        rows: list[dict[str, Any]] = [
            {f"{t}.{n}".strip("."): leaf for t, n, leaf in _leaves("", "", e)} for e in value
        ]
        leaves = [leaf for row in rows for leaf in row.values()]
        if len(rows) > 1 and all(isinstance(x, np.ndarray) and x.size == 1 for x in leaves):
            for field in dict.fromkeys(key for row in rows for key in row):
                cells = [row[field].item() if field in row else np.nan for row in rows]
                kind = object if any(isinstance(cell, str) for cell in cells) else float
                place = (base, field) if field else (top, name)
                yield *place, np.array(cells, dtype=kind)
            return
        for number, element in enumerate(value, 1):
            own = "" if isinstance(element, dict | list) else base.rpartition("/")[2]
            yield from _leaves(f"{base}/{number}", own, element)
    else:
        yield top, name, value


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
        fields = {name: _of_hdf5(inner, stored) for name, inner in value.items()}
        sizes = {len(f) if isinstance(f, list) else 0 for f in fields.values()}
        if len(sizes) == 1 and (size := sizes.pop()):  # an array of structs
            return [{k: v[i] for k, v in fields.items()} for i in range(size)]  # type: ignore[index]
        return fields
    if value.dtype.hasobject:
        return [_of_hdf5(stored[reference], stored) for reference in value[()].T.ravel()]
    if "MATLAB_empty" in value.attrs:
        return "empty arrays"
    if kind == "char":  # a row of characters a text
        return np.squeeze(np.array(["".join(map(chr, row)) for row in value[()].T], dtype=object))
    return value[()]
