"""NMEA 0183, with or without the stamps of a logger: a source a sentence type, by pynmea2."""

import re
from collections import Counter, defaultdict
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from pynmea2 import NMEASentence, TalkerSentence

from seatrial.models.errors import RecordingError
from seatrial.models.recording.formats.text import NUMBER_TEXT, content
from seatrial.models.recording.source import (
    ReadOptions,
    Rows,
    Source,
    TextArray,
    check_size,
    column_of_cells,
)
from seatrial.models.vessel.basis import Array

TIME = "time"
DAY = 86400.0  # [s]
SENTENCE = re.compile(r"([$!])(P[A-Z0-9]{3,}|[A-Z]{2}[A-Z0-9]{3}),([^*$!\r\n\"]*)(?:\*([0-9A-Fa-f]{2}))?")
# Stamps of loggers: date-times, seconds of a tag block, a number of seconds and its parts, clocks.
STAMPS = [
    re.compile(pattern)
    for pattern in (
        r"(\d{1,4}[-/.]\d\d?[-/.]\d{1,4}[T ]+\d?\d:\d\d:\d\d(?:[.,]\d+)?(?:Z|[+-]\d\d:?\d\d)?)",
        r"\\[^\\]*\bc:(\d{9,})", r"(\d?\d:\d\d:\d\d(?:[.,]\d+)?)",
        r"(?:^|[\s,;\[(])(\d+(?:\.\d+)?)(?=[\s,;:\])\"]|$)",
    )
]  # fmt: skip
# Sentences that the package does not know.
FIELDS = {"THS": ("heading", "status"), "HSC": ("heading_true", "true", "heading_mag", "magnetic")}
UNITS = {  # beginnings or ends of the names of fields, the longest that fits
    "spd_over_grnd": "knot", "_kts": "knot", "_knots": "knot", "_kmph": "km/h", "_kn": "knot",
    "water_speed_km": "km/h", "wind_speed_km": "km/h", "wind_speed_meters": "m/s", "_ms": "m/s",
    "lon_water_spd": "knot", "trans_water_spd": "knot", "lon_grnd_spd": "knot",
    "trans_grnd_spd": "knot", "true_course": "deg", "true_track": "deg", "mag_track": "deg",
    "heading": "deg", "deviation": "deg", "variation": "deg", "mag_variation": "deg",
    "direction_true": "deg", "direction_magnetic": "deg", "wind_angle": "deg", "latitude": "deg",
    "longitude": "deg", "rate_of_turn": "deg/min", "rsa_": "deg", "depth": "m", "offset": "m",
    "altitude": "m", "geo_sep": "m", "depth_feet": "ft", "depth_fathoms": "fathom",
    "depth_meters": "m", "std_dev": "m", "deg_t": "deg", "deg_m": "deg", "deg_r": "deg",
}  # fmt: skip
LETTERS = {"N": "knot", "K": "km/h", "M": "m/s", "D": "deg", "R": "rpm", "C": "degC", "P": "Pa"}


def read(path: Path, options: ReadOptions) -> list[Source]:
    """The sentences of a log; raises RecordingError if there are none."""
    data, said = content(path, options.text)
    tables: dict[tuple[str, str], Rows] = defaultdict(Rows)
    units: dict[tuple[str, str], dict[str, str]] = defaultdict(dict)
    stamps: dict[tuple[str, str], list[str]] = defaultdict(list)
    lost: Counter[str] = Counter()
    lines = data.decode().splitlines()
    check_size(path, 8 * len(lines))
    dated = next((day for line in lines for m in SENTENCE.finditer(line)
                  if (day := _clock(m[2][-3:], m[3].split(","))[1]) is not None), 0.0)  # fmt: skip
    day, clock, stamped = dated, np.nan, 0
    for line in lines:
        end = 0
        for match in SENTENCE.finditer(line):
            talker, kind, cells = match[2][:-3], match[2][-3:], match[3].split(",")
            if match[2].startswith("P"):
                talker, kind = "", match[2]
            beside, end = line[end : match.start()] or line[match.end() :], match.end()
            if match[1] == "!":
                lost["of AIS (they start with !)"] += 1
                continue
            if match[4] and int(match[4], 16) != NMEASentence.checksum(f"{match[2]},{match[3]}"):
                lost["with a wrong checksum"] += 1
                continue
            seconds, date = _clock(kind, cells)
            if seconds is not None:
                if date is not None:
                    day = date
                elif clock - day - seconds > DAY / 2.0:  # past midnight
                    day += DAY
                clock = day + seconds
            names = FIELDS.get(kind) or [f[1] for f in getattr(TalkerSentence.sentence_types.get(
                kind), "fields", ())] or [f"c{i + 1}" for i in range(len(cells))]  # fmt: skip
            raw = dict(zip(names, (cell.strip() for cell in cells), strict=False))
            if raw.get("status") == "V":
                lost[f"{kind} of status V (not valid)"] += 1
                continue
            stamp = next((found[1] for p in STAMPS if (found := p.search(beside))), "")
            if not stamp and np.isnan(clock):
                lost["before the first time"] += 1
                continue
            stamped += bool(stamp)
            kind, values, own = _values(kind, raw, cells)
            key = (kind, talker)
            tables[key].add([(TIME, clock), *values])
            stamps[key].append(stamp)
            units[key] |= own
    if not tables:
        raise RecordingError(f"{path}: got no sentence of NMEA 0183 with a time{_lines(lost)}")
    talkers = Counter(kind for kind, _ in tables)
    sources = []
    for (kind, talker), rows in tables.items():
        columns = rows.columns()
        known = {TIME: "s"} | units[kind, talker]
        if stamped:
            columns[TIME] = _times(stamps[kind, talker])
            if columns[TIME].dtype == np.object_ or ":" not in stamps[kind, talker][0]:
                del known[TIME]
        name = kind if talkers[kind] == 1 else f"{kind}/{talker}"
        sources.append(Source(name, path, columns, known, left_out=() if sources else (
            *said, *(f"{count} sentences {reason}" for reason, count in lost.items()))))  # fmt: skip
    return sources


def _lines(lost: Counter[str]) -> str:
    return "".join(f"; {count} sentences {reason}" for reason, count in lost.items())


def _clock(kind: str, cells: list[str]) -> tuple[float | None, float | None]:
    """The time of day of a sentence [s] and the day [s since 1970], None where it has none."""
    fields = [f[1] for f in getattr(TalkerSentence.sentence_types.get(kind), "fields", ())]
    raw = dict(zip(fields, cells, strict=False))
    time = re.fullmatch(r"(\d\d)(\d\d)(\d\d(?:\.\d*)?)", raw.get("timestamp", ""))
    seconds = 3600.0 * int(time[1]) + 60.0 * int(time[2]) + float(time[3]) if time else None
    try:
        if kind == "RMC":
            date = datetime.strptime(raw["datestamp"], "%d%m%y")
        elif kind == "ZDA":
            date = datetime(int(raw["year"]), int(raw["month"]), int(raw["day"]))
        else:
            return seconds, None
    except (ValueError, KeyError):
        return seconds, None
    return seconds, date.replace(tzinfo=UTC).timestamp()


def _values(
    kind: str, raw: dict[str, str], cells: list[str]
) -> tuple[str, list[tuple[str, float | str]], dict[str, str]]:
    """The source of a sentence, its numbers and texts by name, and their units."""
    values: list[tuple[str, float | str]] = []
    units: dict[str, str] = {}
    if kind == "XDR":  # type, value, unit and name of each transducer
        for _, value, unit, name in zip(*(iter(cells),) * 4, strict=False):
            if NUMBER_TEXT.fullmatch(value):
                values.append((name, float(value)))
                units |= {name: LETTERS[unit]} if unit in LETTERS else {}
        return kind, values, units
    for name, cell in raw.items():
        if name in ("lat", "lon"):
            degrees = re.fullmatch(r"(\d*?)(\d{1,2}(?:\.\d*)?)", cell)
            side = raw.get(f"{name}_dir", "")
            if degrees and side in ("N", "S", "E", "W"):
                value = float(degrees[1] or 0) + float(degrees[2]) / 60.0
                name = "latitude" if name == "lat" else "longitude"
                values.append((name, -value if side in "SW" else value))
        elif NUMBER_TEXT.fullmatch(cell) and name not in ("timestamp", "datestamp"):
            values.append((name, float(cell)))
        elif cell:
            values.append((name, cell))
        else:
            continue
        fits = [key for key in UNITS if name.startswith(key) or name.endswith(key)]
        if fits and isinstance(values[-1][1], float):
            units[name] = UNITS[max(fits, key=len)]
    if kind == "MWV" and raw.get("reference"):  # relative and true wind are different quantities
        kind += f"/{raw['reference']}"
        units |= {"wind_speed": LETTERS[u]} if (u := raw.get("wind_speed_units", "")) in LETTERS else {}
    elif kind == "RPM":  # of a shaft or an engine, and its number
        kind += f"/{raw.get('source', '')}{raw.get('engine_no', '')}"
        units |= {"speed": "rpm", "pitch": "percent"}
    return kind, values, units


def _times(stamps: list[str]) -> Array | TextArray:
    """The stamps of a logger as a column: numbers, date-times, or seconds of clocks from the first."""
    times = column_of_cells([stamp.replace(",", ".") for stamp in stamps])
    if times.dtype != np.object_ or "-" in stamps[0] or "/" in stamps[0]:
        return times
    parts = np.array([[*map(float, t.split(":"))] if t.count(":") == 2 else [np.nan] * 3 for t in times])
    return np.unwrap(parts @ [3600.0, 60.0, 1.0], period=DAY)
