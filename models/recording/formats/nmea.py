"""NMEA 0183, with or without the stamps of a logger: a source a sentence type, by pynmea2."""

import re
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from pynmea2 import NMEASentence, TalkerSentence

from seatrial.models.recording.formats.messages import Key, Messages
from seatrial.models.recording.formats.text import column_of_cells, decoded
from seatrial.models.recording.source import Contents, ReadOptions, Source

DAY = 86400.0  # [s]
SENTENCE = re.compile(
    r"([$!])(P[A-Z0-9]{3,}|[A-Z]{2}[A-Z0-9]{3}),([^*$!\r\n\"]*)(?:\*([0-9A-Fa-f]{2}))?"
)
# Stamps of loggers: date-times, seconds of a tag block, clocks, a number of seconds.
STAMP = re.compile(
    r"(\d{1,4}[-/.]\d\d?[-/.]\d{1,4}[T ]+\d?\d:\d\d:\d\d(?:[.,]\d+)?(?:Z|[+-]\d\d:?\d\d)?)"
    r"|\\[^\\]*\bc:(\d{9,})|(\d?\d:\d\d:\d\d(?:[.,]\d+)?)"
    r"|(?:^|[\s,;\[(])(\d+(?:\.\d+)?)(?=[\s,;:\])\"]|$)"
)
THS = ("heading", "status")  # a sentence that the package does not know
UNITS = {  # of fields, by how their names begin or end, the longest that fits
    "knot": "spd_over_grnd _kts _knots _kn lon_water_spd trans_water_spd lon_grnd_spd "
    "trans_grnd_spd",
    "km/h": "_kmph water_speed_km wind_speed_km",
    "m/s": "wind_speed_meters _ms",
    "deg": "true_course true_track mag_track heading deviation variation mag_variation "
    "direction_true direction_magnetic wind_angle latitude longitude rsa_ deg_t deg_m deg_r",
    "deg/min": "rate_of_turn",
    "m": "depth offset altitude geo_sep depth_meters std_dev",
}
UNIT_OF = {name: unit for unit, names in UNITS.items() for name in names.split()}
LETTERS = {"N": "knot", "K": "km/h", "M": "m/s", "D": "deg", "R": "rpm", "C": "degC", "P": "Pa"}


def read(path: Path, options: ReadOptions) -> Contents:
    """The sentences of a log that have a time, each type by each talker."""
    data, said = decoded(path, options.text.encoding)
    lines = data.decode().splitlines()
    messages, units = Messages(path), defaultdict[Key, dict[str, str]](dict)
    stamps, lost = defaultdict[Key, list[str]](list), Counter[str]()
    days = (_day(raw) for *_, raw, _ in _sentences(lines, Counter()))
    day, clock = next((d for d in days if d is not None), 0.0), np.nan
    for kind, talker, raw, beside in _sentences(lines, lost):
        if time := re.fullmatch(r"(\d\d)(\d\d)(\d\d(?:\.\d*)?)", raw.get("timestamp", "")):
            seconds = 3600.0 * int(time[1]) + 60.0 * int(time[2]) + float(time[3])
            if (own := _day(raw)) is not None:
                day = own
            elif clock - day - seconds > DAY / 2.0:  # past midnight
                day += DAY
            clock = day + seconds
        stamp = next((text for found in STAMP.findall(beside) for text in found if text), "")
        if raw.get("status") == "V":
            lost[f"{kind} of status V (not valid)"] += 1
        elif not stamp and np.isnan(clock):
            lost["before the first time"] += 1
        else:
            known = {}
            if kind == "XDR":  # type, value, unit and name of each transducer
                each = list(zip(*(iter(raw.values()),) * 4, strict=False))
                raw = {name: value for _, value, _, name in each}
                known = {name: LETTERS.get(unit, "") for _, _, unit, name in each}
            elif kind == "MWV":  # relative and true wind are different quantities
                kind += f"/{raw.get('reference', '')}".rstrip("/")
                known = {"wind_speed": LETTERS.get(raw.get("wind_speed_units", ""), "")}
            elif kind == "RPM":  # of a shaft or an engine, and its number
                kind += f"/{raw.get('source', '')}{raw.get('engine_no', '')}"
                known = {"speed": "rpm", "pitch": "percent"}
            messages.add(kind, [("time", clock), *_fields(raw).items()], talker)
            units[kind, talker] |= known
            stamps[kind, talker].append(stamp.replace(",", "."))
    left_out = [*said, *(f"{count} sentences {reason}" for reason, count in lost.items())]
    stamped, sources = any(any(own) for own in stamps.values()), list[Source]()
    for key, name, columns in messages.tables():
        known = {"time": "s"} | units[key]
        if stamped:
            columns["time"], known["time"] = np.array(stamps[key], dtype=object), ""
        for title, cells in columns.items():
            if cells.dtype == np.object_ and title not in ("timestamp", "datestamp"):
                columns[title], reason = column_of_cells(cells.tolist())
                left_out += [f"{name}:{title}: {reason}"] if reason else []
            fits = [end for end in UNIT_OF if title.startswith(end) or title.endswith(end)]
            if fits and columns[title].dtype != np.object_:
                known.setdefault(title, UNIT_OF[max(fits, key=len)])
        known = {title: unit for title, unit in known.items() if unit}
        sources.append(Source(name, path, columns, known))
    return sources, left_out


def _sentences(
    lines: Sequence[str], lost: Counter[str]
) -> Iterator[tuple[str, str, dict[str, str], str]]:
    """Type and talker of each sentence, its fields, and the text of the logger beside it."""
    for line in lines:
        end = 0
        for match in SENTENCE.finditer(line):
            mark, tag, body, checksum = match.groups()
            beside, end = line[end : match.start()] or line[match.end() :], match.end()
            if mark == "!":
                lost["of AIS (they start with !)"] += 1
            elif checksum and int(checksum, 16) != NMEASentence.checksum(f"{tag},{body}"):
                lost["with a wrong checksum"] += 1
            else:
                talker, kind = ("", tag) if tag.startswith("P") else (tag[:-3], tag[-3:])
                cells = [cell.strip() for cell in body.split(",")]
                fields = getattr(TalkerSentence.sentence_types.get(kind), "fields", ())
                names = THS if kind == "THS" else [each[1] for each in fields]
                if kind == "XDR":  # as many as there are transducers
                    names = [str(i) for i in range(len(cells))]
                names = names or [f"c{i + 1}" for i in range(len(cells))]
                yield kind, talker, dict(zip(names, cells, strict=False)), beside


def _day(raw: dict[str, str]) -> float | None:
    """The day of a sentence [s since 1970]; None if it has none."""
    text = raw.get("datestamp") or raw.get("day", "") + raw.get("month", "") + raw.get("year", "")
    try:
        date = datetime.strptime(text, "%d%m%y" if len(text) == 6 else "%d%m%Y") if text else None
    except ValueError:
        return None
    return date.replace(tzinfo=UTC).timestamp() if date else None


def _fields(raw: dict[str, str]) -> dict[str, str]:
    """The fields of a sentence, with latitude and longitude in degrees."""
    fields = {name: cell for name, cell in raw.items() if cell and name not in ("lat", "lon")}
    for short, name in (("lat", "latitude"), ("lon", "longitude")):
        degrees = re.fullmatch(r"(\d*?)(\d{1,2}(?:\.\d*)?)", raw.get(short, ""))
        if degrees and (side := raw.get(f"{short}_dir", "")) in ("N", "S", "E", "W"):
            angle = float(degrees[1] or 0) + float(degrees[2]) / 60.0
            fields[name] = repr(-angle if side in "SW" else angle)
    return fields
