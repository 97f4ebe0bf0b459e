"""Times of a recording: numbers of any unit, seconds with nanoseconds, dates and times of day."""

import re
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.recording.column_map import Column
from seatrial.models.recording.source import Source, TextArray
from seatrial.models.recording.units import factor, unit_in_title, words_of
from seatrial.models.vessel.basis import Array

if TYPE_CHECKING:  # slow to import
    import pandas as pd
else:
    import lazy_loader

    pd = lazy_loader.load("pandas")

EPOCH_S = 1e8  # [s] later times are dates
EPOCHS = {"ns": 1e17, "us": 1e14, "ms": 1e11, "s": EPOCH_S}  # least number of an epoch since 1970
DAY_S = 86400.0
PLAUSIBLE_S = (0.005, 15.0)  # [s] of a sample time
LONGEST_STEP = 1e3  # of an epoch in s: numbers with longer steps count us or ns since the start
RISING = 0.9  # share of steps of a time that rise
NUMBERED = re.compile(r"(\d{1,2})([./-])(\d{1,2})\2(\d{4}|\d{2})\b")  # a date, the year last
ISO = re.compile(r"\d{4}[-/.]\d{1,2}[-/.]\d{1,2}")
CLOCK = re.compile(r"-?\d{1,2}:\d{2}(:\d{2}([.,]\d+)?)?")
# Words of the title of a time, most telling first.
TITLES = (
    r"time|timestamp|time_stamp|utc|datetime|date_time|stamp|time_utc|utc_time|date|tid",
    r"(original|elapsed|unix|gps|system|local|log|ros|rec|present|m_present|record)_?(date)?_?time(_?stamp)?",
    r"t|(time_)?(sec|secs|second|seconds)|epoch|utime|time_(us|ms|ns|boot|since_boot|unix|gps)|tout|index",
    r".*_stamp(_sec|_secs)?|.*(^|_)time(stamp)?",
)
SECONDS, REST = r"(.*_)?(sec|secs)", ("nsec", "nsecs", "nanosec", "nanosecs", "nanoseconds")
APART = 0.5  # of a sample time: two clocks that disagree by more are named


def seconds(source: Source, column: Column) -> Array:
    """Times [s] of the rows of a source, shape (N,); dates since 1970, UTC; NaN where missing.

    A date without a zone is UTC. Numbers without a unit that can only be an epoch in ms, us or ns
    are taken for one. Raises RecordingError if a cell is neither a number nor a date.
    """
    name = source.find(column.name) or column.name
    values = source.columns.get(name, np.empty(0))
    text = next((str(v) for v in values if str(v).strip()), "") if _is_text(values) else ""
    if column.format or CLOCK.match(text) or ISO.match(text) or NUMBERED.match(text):
        times = _of_texts(source, name, column)
    else:
        times = source.numbers(name, gaps=True)
        unit = column.unit or source.units.get(name) or unit_in_title(name, ("s",))
        times = times * (factor(unit, "s") if unit else factor(_epoch(times) or "s", "s"))
    if column.nanoseconds is not None:
        times = times + 1e-9 * source.numbers(column.nanoseconds, gaps=True)
    if column.date is not None:
        days = seconds(source, Column(column.date, format=None))
        times = days + times % DAY_S
    if column.uniform and len(times) > 1:
        times = np.linspace(times[0], times[-1], len(times))
    return column.sign * times


def _is_text(values: Array | TextArray) -> bool:
    return bool(values.dtype == np.object_)


def _epoch(times: Array) -> str | None:
    """The unit of numbers that can only be an epoch since 1970."""
    size = float(np.nanmedian(np.abs(times))) if np.any(np.isfinite(times)) else 0.0
    return next((unit for unit, least in EPOCHS.items() if size > least), None)


def _of_texts(source: Source, name: str, column: Column) -> Array:
    """Dates, or times of day with midnight passed, as seconds."""
    cells = pd.Series([str(cell).strip() for cell in source.columns[name]])
    empty = cells.eq("") | cells.str.lower().isin(("nan", "nat", "none", "null", "n/a"))
    first = cells[~empty].iloc[0]
    if column.format is None and CLOCK.fullmatch(first.rstrip("Zz")):
        whole = cells.str.rstrip("Zz").str.replace(",", ".").where(~empty)
        whole = whole.where(whole.str.count(":") != 1, whole + ":00")
        times = pd.to_timedelta(whole, errors="coerce").dt.total_seconds().to_numpy(copy=True)
        times += DAY_S * np.cumsum(np.diff(times, prepend=times[:1]) < -0.5 * DAY_S)
    else:
        written, texts = column.format, cells.where(~empty)
        if written is None and NUMBERED.match(first):
            written = _order(source, name, texts) + _clock_format(first)
        if written is None:
            written, texts = "ISO8601", texts.str.replace("/", "-")
        stamps = pd.to_datetime(texts, format=written, utc=True, errors="coerce")
        if written.endswith(".%f") and stamps.isna().sum() > empty.sum():  # some without fraction
            whole = written.removesuffix(".%f")
            stamps = stamps.fillna(pd.to_datetime(texts, format=whole, utc=True, errors="coerce"))
        times = stamps.astype("datetime64[ns, UTC]").astype(np.int64).to_numpy() * 1e-9
        times[stamps.isna().to_numpy()] = np.nan
    wrong = np.isnan(times) & ~empty.to_numpy()
    if np.any(wrong):
        row = int(np.argmax(wrong))
        raise RecordingError(
            f"{source.path}, column {name}, {source.cell(row, name).place}: got {cells[row]!r}, "
            f"expected a date and time such as {column.format or '2025-04-11T11:51:09.416Z'}"
        )
    return np.asarray(times, dtype=np.float64)


def _order(source: Source, name: str, texts: "pd.Series[str]") -> str:
    """How dates with the year last are written: the one order of day and month that fits all."""
    parts = texts.dropna().str.extract(NUMBERED)
    sign, year = str(parts[1].iloc[0]), "%Y" if len(str(parts[3].iloc[0])) == 4 else "%y"
    first, second = (parts[k].astype(float).max() for k in (0, 2))
    day_first = first > 12 or (sign == "." and second <= 12)
    if first <= 12 and second <= 12 and sign != ".":
        raise RecordingError(
            f"{source.path}, column {name}: got {texts.iloc[0]!r}, is the day or the month first? "
            f"columns.time: {{column: {name}, format: '%d{sign}%m{sign}{year}"
            f"{_clock_format(str(texts.iloc[0]))}'}}"
        )
    return sign.join(("%d", "%m", year) if day_first else ("%m", "%d", year))


def _clock_format(text: str) -> str:
    """How the time of day after a date is written."""
    rest = NUMBERED.sub("", text, count=1)
    form = re.sub(r"\d{1,2}:\d{2}:\d{2}\.\d+", "%H:%M:%S.%f", rest)
    form = re.sub(r"\d{1,2}:\d{2}:\d{2}", "%H:%M:%S", form)
    form = re.sub(r"\d{1,2}:\d{2}", "%H:%M", form)
    return re.sub(r"[AaPp][Mm]$", "%p", form).replace("%H", "%I" if form[-1:] in "mM" else "%H")


def is_later(t: Array) -> NDArray[np.bool_]:
    """Which times (N,) are later than all before them; missing ones are not."""
    highest = np.fmax.accumulate(t)
    later = np.concatenate([np.ones(min(len(t), 1), dtype=np.bool_), t[1:] > highest[:-1]])
    return np.asarray(later & ~np.isnan(t))


def find_time(source: Source) -> Column | None:
    """The column of time of a source by its title, with its unit; None: none.

    One that never goes back is preferred to one that does.
    """
    known = list(clocks(source))
    steady = (c for c in known if not np.any(np.diff(seconds(source, c)) < 0.0))
    return next(steady, known[0] if known else None)


def clocks(source: Source) -> Iterator[Column]:
    """All columns of a source that are times by their titles, the most telling first."""
    seen: set[str] = set()
    for pattern in (*TITLES, SECONDS):
        for name in source.columns:
            title = "_".join(words_of(name))
            bare = re.sub(r"_(s|sec|secs|ms|us|ns|usec|msec)$", "", title)
            if name in seen or not any(re.fullmatch(pattern, text) for text in (title, bare)):
                continue
            if (column := _clock(source, name, title)) is not None:
                seen.add(name)
                yield column


def _clock(source: Source, name: str, title: str) -> Column | None:
    """A column as a time, with what else is needed to read it; None if it does not rise."""
    stem = re.sub(r"(secs?|time|date)$", "", title)
    siblings = {"_".join(words_of(other)): other for other in source.columns}
    rest = next((siblings[stem + r] for r in REST if stem + r in siblings), None)
    column = Column(name, nanoseconds=rest if re.fullmatch(SECONDS, title) else None)
    if _is_text(source.columns[name]):
        text = next((str(v).strip() for v in source.columns[name] if str(v).strip()), "")
        day = next((siblings[d] for d in (f"{stem}date", "date", "day") if d in siblings), None)
        if CLOCK.match(text) and day and day != name:
            column = Column(name, date=day)
        elif not any(ch in text for ch in ":T") and "time" in siblings and siblings["time"] != name:
            return None  # the day alone, which a time of day stands beside
    try:
        t = seconds(source, column)
    except (ConfigurationError, RecordingError):
        return None
    steps = np.diff(t[np.isfinite(t)])
    if not len(steps) or not np.mean(steps >= 0.0) >= RISING or not np.any(steps > 0.0):
        return None
    if _is_text(source.columns[name]) or source.units.get(name):
        return column
    unit = unit_in_title(name, ("s",)) or _epoch(source.numbers(name, gaps=True))
    step = float(np.median(steps[steps > 0.0]))
    if unit is None or (unit == "s" and step > LONGEST_STEP):
        fitting = [u for u in ("s", "ms", "us", "ns", "day")
                   if PLAUSIBLE_S[0] <= step * factor(u, "s") <= PLAUSIBLE_S[1]]  # fmt: skip
        unit = fitting[0] if fitting else None
    return Column(name, unit=None if unit == "s" else unit, nanoseconds=column.nanoseconds)


def disagreement(source: Source, used: Column) -> str | None:
    """What is said of another clock of a source that does not run like the one in use."""
    t = seconds(source, used)
    for other in clocks(source):
        if other.name == source.find(used.name) or len(t) < 3:
            continue
        apart = seconds(source, other) - t
        lengths = [float(np.nanmax(clock) - np.nanmin(clock)) for clock in (apart + t, t)]
        if not 0.9 * lengths[1] < lengths[0] < 1.1 * lengths[1]:
            continue  # not a time, though it is named and rises like one
        apart -= np.nanmedian(apart)
        period = float(np.nanmedian(np.abs(np.diff(t))))
        count = int(np.sum(np.abs(apart) > APART * max(period, 1e-3)))
        if count:
            rest = f", nanoseconds: {other.nanoseconds}" if other.nanoseconds else ""
            unit = f", unit: {other.unit}" if other.unit else ""
            return (
                f"{source.name}: the clocks {used.name} and {other.name} disagree in {count} of "
                f"{len(t)} rows, by up to {np.nanmax(np.abs(apart)):.2g} s; columns.time: "
                f"{{column: {other.name}{rest}{unit}}} reads the other"
            )
    return None
