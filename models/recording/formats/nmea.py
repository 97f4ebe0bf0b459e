"""NMEA 0183, with or without the stamps of a logger: a source a sentence type, by pynmea2."""

import re
from calendar import timegm
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from contextlib import suppress
from itertools import islice
from pathlib import Path

import numpy as np
from pynmea2 import ChecksumError, NMEASentence, TalkerSentence

from seatrial.models.recording.formats.messages import Key, Messages
from seatrial.models.recording.formats.text import decoded
from seatrial.models.recording.source import Contents, ReadOptions

DAY = 86400.0  # [s]
TIME = re.compile(r"(\d\d)(\d\d)(\d\d(?:\.\d*)?)")
SENTENCE = re.compile(r"[$!](P[A-Z0-9]{3,}|[A-Z]{2}[A-Z0-9]{3}),[^*$!\r\n\"]*(?:\*[0-9A-Fa-f]{2})?")
# Stamps of loggers: date-times, seconds of a tag block, clocks, a number of seconds.
STAMP = re.compile(
    r"(\d{1,4}[-/.]\d\d?[-/.]\d{1,4}[T ]+\d?\d:\d\d:\d\d(?:[.,]\d+)?(?:Z|[+-]\d\d:?\d\d)?)"
    r"|\\[^\\]*\bc:(\d{9,})|(\d?\d:\d\d:\d\d(?:[.,]\d+)?)"
    r"|(?:^|[\s,;\[(])(\d+(?:\.\d+)?)(?=[\s,;:\])\"]|$)"
)
UNITS = {  # of fields, by regular expressions of their names, the first that fits
    "km/h": "_kmph$|_km$", "m/s": "_ms$|speed_meters$", "knot": "_knots$|_kts$|_kn$|spd",
    "deg/min": "rate_of_turn", "ft": "_feet$", "fathom": "_fathoms$",
    "m": "^depth|^offset|^altitude|^geo_sep|^std_dev|^heave",
    "deg": "heading|course$|_track$|deviation|variation$|^direction|angle|^rsa_|^deg_|roll|pitch",
    "lat": "^latitude", "lon": "^longitude",  # degrees and minutes
}  # fmt: skip
SPEEDS = {"N": "knot", "K": "km/h", "M": "m/s"}
TRANSDUCERS = {"D": "deg", "R": "rpm", "C": "degC", "P": "Pa", "M": "m", "B": "bar"}
# Fields that tell quantities apart: relative and true wind, shafts and engines.
APART = {"MWV": ("reference",), "RPM": ("source", "engine_no")}


class THS(TalkerSentence):  # type: ignore[misc]
    """True heading and status, by which pynmea2 knows the sentence from now on."""

    fields = (("Heading", "heading"), ("Status", "status"))


def read(path: Path, options: ReadOptions) -> Contents:
    """The sentences of a log that have a time, each type by each talker."""
    data, said = decoded(path, options.text.encoding)
    lines, lost = data.decode().splitlines(), Counter[str]()
    messages, units = Messages(path), defaultdict[Key, dict[str, str]](dict)
    stamped = any(stamp for _, stamp in islice(_sentences(lines, Counter()), 9))
    days = (_day(sentence) for sentence, _ in _sentences(lines, Counter()))
    day, clock = next((d for d in days if d is not None), 0.0), np.nan
    for sentence, stamp in _sentences(lines, lost):
        kind, cells = type(sentence).__name__, [cell.strip() for cell in sentence.data]
        names = [{"lat": "latitude", "lon": "longitude"}.get(f[1], f[1]) for f in sentence.fields]
        fields = dict(zip(names, cells, strict=False))
        if time := TIME.fullmatch(fields.pop("timestamp", "")):
            seconds = 3600.0 * int(time[1]) + 60.0 * int(time[2]) + float(time[3])
            if (own := _day(sentence)) is not None:
                day = own
            elif clock - day - seconds > DAY / 2.0:  # past midnight
                day += DAY
            clock = day + seconds
        if fields.get("status") == "V":
            lost[f"{kind} of status V (not valid)"] += 1
        elif not stamp and (stamped or np.isnan(clock)):
            lost["without a time"] += 1
        else:
            apart = "".join(fields.get(name, "") for name in APART.get(kind, ()))
            key, known = (f"{kind}/{apart}".rstrip("/"), getattr(sentence, "talker", "")), {}
            if kind == "XDR":  # type, value, unit and name of each transducer
                each = list(zip(*(iter(cells),) * 4, strict=False))
                fields = {name: value for _, value, _, name in each}
                known = {name: TRANSDUCERS.get(unit, "") for _, _, unit, name in each}
            elif key not in units:
                forms = list(UNITS.items())
                known = {name: next((unit for unit, form in forms if re.search(form, name)), "")
                         for name in fields}  # fmt: skip
                if kind == "MWV":
                    known["wind_speed"] = SPEEDS.get(fields.get("wind_speed_units", ""), "")
                elif kind == "RPM":
                    known |= {"speed": "rpm", "pitch": "percent"}
            row = {name: cell for name, cell in fields.items() if cell and name != "datestamp"}
            messages.add(*key, {"time": stamp if stamped else clock} | row)
            units[key] |= known | ({} if stamped else {"time": "s"})
    return messages.contents(units, [*said, *(f"{n} sentences {why}" for why, n in lost.items())])


def _sentences(lines: Sequence[str], lost: Counter[str]) -> Iterator[tuple[NMEASentence, str]]:
    """The sentences, and the stamp of a logger beside each."""
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


def _day(sentence: NMEASentence) -> float | None:
    """The day of a sentence [s since 1970]; None if it has none."""
    with suppress(AttributeError, TypeError, ValueError):  # of what is no date
        return float(timegm(sentence.datestamp.timetuple()))
    return None
