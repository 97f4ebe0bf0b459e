"""Excel, Parquet, MATLAB 5 and 7.3 (HDF5), netCDF; and logs of messages, a source a topic or type.

The messages are those of ROS, MCAP, ArduPilot, MAVLink, PX4 and NMEA 0183.
"""

import re
from calendar import timegm
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import fields, is_dataclass, replace
from itertools import chain, islice
from pathlib import Path
from textwrap import shorten
from typing import Any

import numpy as np
import pandas as pd
import scipy
from pyarrow import parquet

from seatrial.models.errors import RecordingError
from seatrial.models.recording.formats.text import decoded, table, table_source
from seatrial.models.recording.source import MOST_ELEMENTS, Contents, ReadOptions, check_size

TIMES = {"TimeUS": "us", "TimeMS": "ms", "timestamp": "s"}  # of ArduPilot and MAVLink
PACKED = 1000  # rows of a frame
DAY = 86400.0  # [s]
TIME = re.compile(r"(\d\d)(\d\d)(\d\d(?:\.\d*)?)")
SENTENCE = re.compile(r"[$!](P[A-Z0-9]{3,}|[A-Z]{2}[A-Z0-9]{3}),[^*$!\r\n\"]*(?:\*[0-9A-Fa-f]{2})?")
# Stamps of loggers: date-times, seconds of a tag block, clocks, a number of seconds.
STAMP = re.compile(
    r"(\d{1,4}[-/.]\d\d?[-/.]\d{1,4}[T ]+\d?\d:\d\d:\d\d(?:[.,]\d+)?(?:Z|[+-]\d\d:?\d\d)?)"
    r"|\\[^\\]*\bc:(\d{9,})|(\d?\d:\d\d:\d\d(?:[.,]\d+)?)"
    r"|(?:^|[\s,;\[(])(\d+(?:\.\d+)?)(?=[\s,;:\])\"]|$)"
)
UNITS = {  # by regular expressions of a sentence and its field, the first that fits
    "rpm": "RPM.* speed", "percent": "RPM.* pitch",
    "km/h": "_kmph$|_km$", "m/s": "_ms$|speed_meters$", "knot": "_knots$|_kts$|_kn$|spd",
    "deg/min": "rate_of_turn", "ft": "_feet$", "fathom": "_fathoms$",
    "m": " (depth|offset|altitude|geo_sep|std_dev|heave)",
    "deg": "heading|course$|_track$|deviation|variation$| (direction|rsa_|deg_)|angle|roll|pitch",
    "lat": " latitude", "lon": " longitude",  # degrees and minutes
}  # fmt: skip
SPEEDS = {"N": "knot", "K": "km/h", "M": "m/s"}
TRANSDUCERS = {"D": "deg", "R": "rpm", "C": "degC", "P": "Pa", "M": "m", "B": "bar"}
# Fields that tell quantities apart: relative and true wind, shafts and engines.
APART = {"MWV": ("reference",), "RPM": ("source", "engine_no")}
Key = tuple[str, str]  # what a message is, and who sent it


def read_excel(path: Path, options: ReadOptions) -> Contents:
    """The sheets of a workbook, read like the text that their cells would be."""
    text = replace(options.text, separator=",", decimal=".", encoding=None, comment=None)
    options, sources, left_out = replace(options, text=text), [], []
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


class Messages:
    """Rows by kind and sender, packed into frames now and then; what a message lacks is missing."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.rows = defaultdict[Key, list[dict[str, float | str]]](list)
        self.frames = defaultdict[Key, list[pd.DataFrame]](list)
        self.long: dict[str, int] = {}  # arrays that are left out

    def add(self, kind: str, sender: str, values: Mapping[str, object]) -> None:
        """Add a message: its numbers, texts, arrays and messages within it by name."""
        rows, frames = self.rows[kind, sender], self.frames[kind, sender]
        leaves = (self._leaves(kind, name, value) for name, value in values.items())
        rows.append(dict(chain.from_iterable(leaves)))
        if len(rows) == PACKED:
            frames.append(pd.DataFrame(rows))
            rows.clear()
            check_size(self.path, 8 * sum(f.size for own in self.frames.values() for f in own))

    def _leaves(self, kind: str, name: str, value: Any) -> Iterator[tuple[str, float | str]]:
        """The numbers and texts of a value by dotted name, elements of arrays as `name[0]`."""
        if isinstance(value, str):
            yield name, value
        elif isinstance(value, int | float | np.number | np.bool_):
            yield name, float(value)
        elif is_dataclass(value):
            for field in (field.name for field in fields(value) if field.name[:2] != "__"):
                yield from self._leaves(kind, f"{name}.{field}".lstrip("."), getattr(value, field))
        elif hasattr(value, "__len__") and len(value) > MOST_ELEMENTS:
            self.long[f"{kind}, {name}"] = len(value)
        elif hasattr(value, "__len__"):
            for i, element in enumerate(value):
                yield from self._leaves(kind, f"{name}[{i}]", element)

    def contents(self, unit: Callable[[Key, str], str], left_out: Sequence[str]) -> Contents:
        """The columns of each kind and sender as a source, and what was left out."""
        kinds, sources = Counter(kind for kind, _ in self.rows), []
        for key, rows in self.rows.items():
            frame = pd.concat([*self.frames[key], pd.DataFrame(rows)])
            columns = ((str(name), cells, unit(key, str(name))) for name, cells in frame.items())
            name = key[0] if kinds[key[0]] == 1 else "/".join(key)
            sources.append(table_source(name, self.path, columns))
        long = (f"{name}: arrays of {size} elements" for name, size in self.long.items())
        return sources, [*left_out, *long]


def read_bag(path: Path, options: ReadOptions) -> Contents:
    """The topics of a bag, each with the times at which its messages were recorded.

    Messages that are defined neither in the bag nor by a file of `options` are left out. The file
    is named as in its package, `boat_msgs/msg/Ballast.msg`, or it is of those that are not known.
    """
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    messages, left_out, known, common = Messages(path), [], [], get_typestore(Stores.LATEST)
    with AnyReader([path], default_typestore=common) as bag:
        types = common.fielddefs | bag.typestore.fielddefs
        strange = {c.msgtype.partition("/")[0] for c in bag.connections if c.msgtype not in types}
        for file in (Path(name).expanduser() for name in options.messages):
            named = file.parent.parent.name if file.parent.name == "msg" else ""
            for package in [named] if named else strange:
                text = file.read_text(encoding="utf-8")
                types |= get_types_from_msg(text, f"{package}/msg/{file.stem}")
        bag.typestore.register({k: v for k, v in types.items() if k not in bag.typestore.fielddefs})
        for connection in bag.connections:
            try:
                bag.typestore.get_msgdef(connection.msgtype)
                known.append(connection)
            except KeyError as error:
                topic, missing = f"topic {connection.topic} ({connection.msgtype})", error.args[0]
                way = f"excitation.messages=[{missing.rpartition('/')[2]}.msg] gives it"
                left_out.append(f"{topic}: the definition of {missing} is not in the file; {way}")
        for connection, time_ns, raw in bag.messages(known) if known else ():
            message = bag.deserialize(raw, connection.msgtype)
            messages.add(connection.topic.lstrip("/"), "", {"time": time_ns / 1e9, "": message})
    silent = {c.topic: None for c in known if (c.topic.lstrip("/"), "") not in messages.rows}
    left_out += [f"topic {name}: no messages" for name in silent]
    return messages.contents(lambda _, name: "s" if name == "time" else "", left_out)


def read_ardupilot(path: Path, options: ReadOptions) -> Contents:
    """The message types of a log (.bin, .log, .tlog), `XKF1/0`, `XKF1/1` of several instances.

    What a ground station received has the time of reception, and may be of several systems.
    """
    from pymavlink import DFReader, mavutil

    logs = {b"\xa3\x95": DFReader.DFReader_binary, b"FM": DFReader.DFReader_text}
    with path.open("rb") as file:
        flash = logs.get(file.read(2))
    log = (flash or mavutil.mavlogfile)(str(path))
    messages, units, read, bad = Messages(path), dict[Key, dict[str, str]](), 0, 0
    for message in iter(log.recv_msg, None):
        kind = message.get_type()
        read += message.fmt.len if flash else 0
        if kind.startswith(("FMT", "BAD_DATA", "UNKNOWN")):
            bad += not flash
            continue
        values = {name: getattr(message, name) for name in message.get_fieldnames()}
        if flash:
            sender = values.get(message.fmt.instance_field, "")
        else:
            sender, values = message.get_srcSystem(), {"timestamp": message._timestamp, **values}
        key = kind, str(sender)
        if key not in units:
            units[key] = (dict(zip(message.fmt.columns, message.fmt.units or (), strict=False))
                           if flash else message.fieldunits_by_name) | TIMES  # fmt: skip
        messages.add(*key, values)
    (log.filehandle if flash else log.f).close()
    lost = path.stat().st_size - read if flash is DFReader.DFReader_binary else 0
    left_out = [f"{lost} bytes that are no messages"] if lost else []
    left_out += [f"{bad} messages that are damaged or of an unknown type"] if bad else []
    return messages.contents(lambda key, name: units[key].get(name, ""), left_out)


def read_ulog(path: Path, options: ReadOptions) -> Contents:
    """The topics of a ULog, `topic`, `topic/1` of several instances, with a `timestamp` in us."""
    from pyulog.core import ULog

    with path.open("rb") as file:  # pyulog leaves a bad file open
        topics = ULog(file).data_list
    return [
        table_source(f"{topic.name}/{topic.multi_id}".removesuffix("/0"), path, (
            (t, cells, "us" if t == "timestamp" else "") for t, cells in topic.data.items()))
        for topic in topics
    ], []  # fmt: skip


def read_nmea(path: Path, options: ReadOptions) -> Contents:
    """The sentences of a log that have a time, each type by each talker."""
    data, said = decoded(path, options.text.encoding)
    lines, lost, messages = data.decode().splitlines(), Counter[str](), Messages(path)
    known = defaultdict[Key, dict[str, str]](dict)  # units by the letters of a sentence
    stamped = any(stamp for _, stamp in islice(_sentences(lines, Counter()), 9))
    days = (_day(sentence) for sentence, _ in _sentences(lines, Counter()))
    day, clock = next((d for d in days if d is not None), 0.0), np.nan
    for sentence, stamp in _sentences(lines, lost):
        kind, cells = type(sentence).__name__, [cell.strip() for cell in sentence.data]
        names = [{"lat": "latitude", "lon": "longitude"}.get(f[1], f[1]) for f in sentence.fields]
        row = dict(zip(names, cells, strict=False))
        if time := TIME.fullmatch(row.pop("timestamp", "")):
            seconds = 3600.0 * int(time[1]) + 60.0 * int(time[2]) + float(time[3])
            if (own := _day(sentence)) is not None:
                day = own
            elif clock - day - seconds > DAY / 2.0:  # past midnight
                day += DAY
            clock = day + seconds
        invalid = f"{kind} of status V (not valid)" if row.get("status") == "V" else ""
        if invalid or (not stamp and (stamped or np.isnan(clock))):
            lost[invalid or "without a time"] += 1
            continue
        apart = "".join(row.get(name, "") for name in APART.get(kind, ()))
        key = f"{kind}/{apart}".rstrip("/"), getattr(sentence, "talker", "")
        if kind == "XDR":  # type, value, unit and name of each transducer
            each = list(zip(*(iter(cells),) * 4, strict=False))
            row = {name: value for _, value, _, name in each}
            known[key] |= {name: TRANSDUCERS.get(unit, "") for _, _, unit, name in each}
        elif kind == "MWV":
            known[key]["wind_speed"] = SPEEDS.get(row.get("wind_speed_units", ""), "")
        row = {name: cell for name, cell in row.items() if cell and name != "datestamp"}
        known[key]["time"] = "" if stamped else "s"
        messages.add(*key, {"time": stamp if stamped else clock} | row)

    def unit(key: Key, name: str) -> str:
        forms = (unit for unit, form in UNITS.items() if re.search(form, f"{key[0]} {name}"))
        return known[key].get(name, "") or next(forms, "")

    return messages.contents(unit, [*said, *(f"{n} sentences {why}" for why, n in lost.items())])


def _sentences(lines: Sequence[str], lost: Counter[str]) -> Iterator[tuple[Any, str]]:
    """The sentences, and the stamp of a logger beside each; pynmea2 is taught THS, a heading."""
    from pynmea2 import ChecksumError, NMEASentence, TalkerSentence

    type("THS", (TalkerSentence,), {"fields": (("Heading", "heading"), ("Status", "status"))})
    for line in lines:
        end = 0
        for match in SENTENCE.finditer(line):
            beside, end = line[end : match.start()] or line[match.end() :], match.end()
            try:
                sentence = NMEASentence.parse(match[0])
                _, *_ = sentence.fields  # a type that is not known has none
            except (ValueError, LookupError) as error:
                wrong = isinstance(error, ChecksumError)
                lost["with a wrong checksum" if wrong else f"{match[1]} of unknown type"] += 1
            else:
                found = (text for texts in STAMP.findall(beside) for text in texts if text)
                yield sentence, next(found, "").replace(",", ".")


def _day(sentence: Any) -> float | None:
    """The day of a sentence [s since 1970]; None if it has none."""
    with suppress(AttributeError, TypeError, ValueError):  # of what is no date
        return float(timegm(sentence.datestamp.timetuple()))
    return None
