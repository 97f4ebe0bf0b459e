"""Times of a recording: numbers of any unit, seconds with nanoseconds, dates and times of day."""

import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.recording.column_map import TITLES as UNIT_TITLES
from seatrial.models.recording.column_map import Column, factor, unit_in_title, words_of
from seatrial.models.recording.source import MISSING, Source
from seatrial.models.vessel.basis import Array

if TYPE_CHECKING:  # slow to import
    import pandas as pd
else:
    import lazy_loader

    pd = lazy_loader.load("pandas")

RESTS = [word for word, units in UNIT_TITLES.items() if {"ns", "us", "ms"} & set(units)]
EPOCH_S = 1e8  # [s] later times are dates
# Least number of an epoch since 1970; the milliseconds of a week of GPS are fewer than the last.
EPOCHS = {"ns": 1e17, "us": 1e14, "ms": 1e11, "s": 6.5e8}
DAY_S, WEEK_S, WORD = 86400.0, 604800.0, 2.0**32  # at which clocks start again
PLAUSIBLE_S = (0.005, 15.0)  # [s] of a sample time
LONGEST_STEP = 1e3  # of an epoch in s: numbers with longer steps count us or ns since the start
RISING = 0.9  # share of steps of a time that rise
NUMBERED = re.compile(r"(\d{1,2})([./-])(\d{1,2})\2(\d{4}|\d{2})\b")  # a date, the year last
ISO = re.compile(r"\d{4}[-/.]\d{1,2}[-/.]\d{1,2}")
ZONE = r"(?<=\d) ?(?:(?![AaPp][Mm])[A-Za-z]{2,5}|[Zz])$"  # only differences matter
CLOCK = re.compile(r"-?\d{1,2}:\d{2}(:\d{2}([.,]\d+)?)?")
# Words of the title of a time, most telling first.
TITLES = (
    r"time|timestamp|time_stamp|utc|date_?time|stamp|time_utc|utc_time|date|zeit|temps|heure|tid",
    r"(original|elapsed|unix|gps|system|local|log|ros|rec|present|m_present|record)_?(date)?_?time(_?stamp)?",
    r"t|ts|(time_)?(sec|secs|second|seconds)|epoch|utime|tout|index",
    r".*_stamp(_sec|_secs)?|(.*_)?time(stamp)?(_.*)?|(.*_)?utc(_.*)?|(gps_|i_?)?tow",
    r"(.*_)?(sec|secs|seconds)(_of_.*)?",
)
APART = 0.5  # of a sample time: two clocks that disagree by more are named


def seconds(source: Source, column: Column) -> Array:
    """Times [s] of the rows of a source, shape (N,); dates since 1970, UTC; NaN where missing.

    A date without a zone is UTC. Numbers without a unit that can only be an epoch in ms, us or ns
    are taken for one. Raises RecordingError if a cell is neither a number nor a date.
    """
    name = source.find(column.name) or column.name
    text = _first_text(source, name)
    if column.format or any(form.match(text) for form in (CLOCK, ISO, NUMBERED)):
        if (name, column) not in source.times:
            source.times[name, column] = _of_texts(source, name, column)
        times = source.times[name, column]
    else:
        times = source.numbers(name, gaps=True)
        unit = column.unit or source.units.get(name) or unit_in_title(name, ("s",))
        if unit is None and (packed := _packed(times)) is not None:
            times = packed
        else:
            size = factor(unit or _epoch(times) or "s", "s")
            times = _unrolled(times * size, (WORD * size, WEEK_S, DAY_S), 0.95)
    if column.nanoseconds is not None:
        times = times + _rest(source, column.nanoseconds)
    if column.date is not None:
        times = seconds(source, Column(column.date)) + times % DAY_S
    if column.uniform and len(times) > 1:
        times = np.linspace(times[0], times[-1], len(times))
    return column.sign * times


def _unrolled(times: Array, periods: Sequence[float], share: float) -> Array:
    """Times (N,) of a counter that starts again at a period, of which it went back `share`."""
    for period in periods:
        steps = np.diff(times, prepend=times[:1])
        times = times + period * np.cumsum((steps < -share * period) & (steps > -1.05 * period))
    return times


def _packed(values: Array) -> Array | None:
    """Numbers such as 235959.5 or 20240507235959 as seconds, (N,); None if they are none."""
    known = values[np.isfinite(values)]
    day, clock = np.divmod(values, 1e6)
    hour, rest = np.divmod(clock, 1e4)
    minute, second = np.divmod(rest, 100.0)
    if not len(known) or np.ptp(known) <= 40.0 or np.min(known) < 0.0:
        return None
    if np.nanmax(hour) >= 24.0 or np.nanmax(minute) >= 60.0 or np.nanmax(second) >= 60.0:
        return None
    start = np.zeros(len(values))
    if np.nanmin(day) > 0.0:
        written = pd.Series(day).map("{:.0f}".format)
        days = pd.to_datetime(written, format="%Y%m%d", errors="coerce")
        if days.isna().all():
            return None
        start = days.astype("datetime64[s]").astype(np.int64).to_numpy().astype(np.float64)
    return _unrolled(start + 3600.0 * hour + 60.0 * minute + second, (DAY_S,), 0.5)


def _rest(source: Source, name: str) -> Array:
    """The rest [s] of the seconds beside them, (N,): in ns, or the unit in the title."""
    unit = unit_in_title(f"of {name}", ("s",)) or "ns"
    return source.numbers(name, gaps=True) * factor(unit, "s")


def _first_text(source: Source, name: str) -> str:
    """The first cell of a column of text; "" of one of numbers."""
    values = source.columns.get(name, np.empty(0))
    cells = values if values.dtype == np.object_ else ()
    return next((text for v in cells if (text := str(v).strip()).lower() not in MISSING), "")


def _epoch(times: Array) -> str | None:
    """The unit of numbers that can only be an epoch since 1970."""
    known = times[np.isfinite(times)]
    size = float(np.median(np.abs(known))) if len(known) else 0.0
    step = float(np.median(np.abs(np.diff(known)))) if len(known) > 1 else 0.0
    likely = (unit for unit, least in EPOCHS.items() if size > least)
    return next((unit for unit in likely if step * factor(unit, "s") <= LONGEST_STEP), None)


def _of_texts(source: Source, name: str, column: Column) -> Array:
    """Dates, or times of day with midnight passed, as seconds."""
    cells = pd.Series([str(cell).strip() for cell in source.columns[name]])
    texts = cells.mask(cells.str.lower().isin(MISSING))
    first = _first_text(source, name)
    if column.format is None:
        texts = texts.str.replace(ZONE, "", regex=True)
    if column.format is None and CLOCK.fullmatch(re.sub(ZONE, "", first)):
        whole = texts.str.replace(",", ".")
        whole = whole.where(whole.str.count(":") != 1, whole + ":00")
        times = pd.to_timedelta(whole, errors="coerce").dt.total_seconds().to_numpy(copy=True)
        times = _unrolled(times, (DAY_S,), 0.5)
    else:
        form = column.format or (
            _format(source, name, texts) if NUMBERED.match(first) else "ISO8601"
        )
        written = texts.str.replace("/", "-") if form == "ISO8601" else texts
        stamps = pd.to_datetime(written, format=form, utc=True, errors="coerce")
        if form.endswith(".%f"):  # some may be without a fraction
            whole = form.removesuffix(".%f")
            stamps = stamps.fillna(pd.to_datetime(texts, format=whole, utc=True, errors="coerce"))
        times = stamps.astype("datetime64[ns, UTC]").astype(np.int64).to_numpy() * 1e-9
        times[stamps.isna().to_numpy()] = np.nan
    wrong = np.isnan(times) & texts.notna().to_numpy()
    if np.sum(wrong) >= 0.5 * np.sum(texts.notna()):  # few others stand for no time
        row = int(np.argmax(wrong))
        expected = f"a date and time such as {column.format or '2025-04-11T11:51:09.416Z'}"
        raise source.refused(row, name, expected)
    return np.asarray(times, dtype=np.float64)


def _format(source: Source, name: str, texts: "pd.Series[str]") -> str:
    """How dates with the year last are written: the one order of day and month that fits all."""
    text = str(texts.dropna().iloc[0])
    clock = re.sub(r"\d{1,2}:\d{2}:\d{2}\.\d+", "%H:%M:%S.%f", NUMBERED.sub("", text, count=1))
    clock = re.sub(r"\d{1,2}:\d{2}", "%H:%M", re.sub(r"\d{1,2}:\d{2}:\d{2}", "%H:%M:%S", clock))
    if clock[-2:].upper() in ("AM", "PM"):
        clock = clock[:-2].replace("%H", "%I") + "%p"
    parts = texts.dropna().str.extract(NUMBERED)
    sign, year = str(parts[1].iloc[0]), "%Y" if len(str(parts[3].iloc[0])) == 4 else "%y"
    first, second = (parts[k].astype(float).max() for k in (0, 2))
    if first <= 12 and second <= 12 and sign != ".":
        raise RecordingError(
            f"{source.path}, column {name}: got {text!r}, is the day or the month first? "
            f"columns.time: {{column: {name}, format: '%d{sign}%m{sign}{year}{clock}'}}"
        )
    day_first = first > 12 or (sign == "." and second <= 12)
    return sign.join(("%d", "%m", year) if day_first else ("%m", "%d", year)) + clock


def is_later(t: Array) -> NDArray[np.bool_]:
    """Which times (N,) are later than all before them; missing ones are not."""
    highest = np.fmax.accumulate(t)
    later = np.concatenate([np.ones(min(len(t), 1), dtype=np.bool_), t[1:] > highest[:-1]])
    return np.asarray(later & ~np.isnan(t))


def find_time(source: Source) -> Column | None:
    """The column of time of a source by its title, with its unit; None: none.

    One that never goes back is preferred to one that does, and to one of which a tenth of the times
    repeat, as whole seconds do, another that runs like it and repeats fewer.
    """
    known = [(column, seconds(source, column)) for column in clocks(source)]
    steady = [(column, t) for column, t in known if not np.any(np.diff(t) < 0.0)]
    if not steady:
        return known[0][0] if known else None
    (first, t), repeats = steady[0], [float(np.mean(np.diff(t) == 0.0)) for _, t in steady]
    finer = (column for (column, other), own in zip(steady, repeats, strict=True)
             if own < 0.5 * repeats[0] > 0.5 * (1.0 - RISING) and _alike(other, t))  # fmt: skip
    return next(finer, first)


def _alike(t: Array, other: Array) -> bool:
    """Whether columns (N,) [s] last equally long, as two times of the same rows do."""
    own, beside = (np.ptp(each[np.isfinite(each)]) for each in (t, other))
    return bool(0.9 * beside < own < 1.1 * beside)


def clocks(source: Source) -> Iterator[Column]:
    """All columns of a source that are times by their titles, the most telling first."""
    titles, ranks = {name: "_".join(words_of(name)) for name in source.columns}, dict[str, int]()
    for name, title in titles.items():
        bare = re.sub(r"_(s|sec|secs|ms|us|ns|usec|msec)$", "", title)
        telling = (i for i, words in enumerate(TITLES)
                   if re.fullmatch(words, title) or re.fullmatch(words, bare))  # fmt: skip
        dated = any(form.match(_first_text(source, name)) for form in (ISO, NUMBERED))
        if (rank := next(telling, len(TITLES) if dated else None)) is not None:
            ranks[name] = rank
    columns = (_clock(source, name, titles) for name in sorted(ranks, key=lambda n: ranks[n]))
    return filter(None, columns)


def _clock(source: Source, name: str, titles: dict[str, str]) -> Column | None:
    """A column as a time, with what else is needed to read it; None if it does not rise."""
    title, siblings = titles[name], {title: other for other, title in titles.items()}
    stem, text = re.sub(r"(secs?|time|date)$", "", title), _first_text(source, name)
    beside = [other for each, other in siblings.items()
              if each.startswith(stem) and each[len(stem) :].strip("_") in RESTS]  # fmt: skip
    column = Column(name)
    day = next((siblings[d] for d in (f"{stem}date", "date", "day") if d in siblings), None)
    if CLOCK.match(text) and day and day != name:
        column = Column(name, date=day)
    elif text and not any(ch in text for ch in ":T") and siblings.get("time", name) != name:
        return None  # the day alone, which a time of day stands beside
    try:
        t = seconds(source, column)
    except (ConfigurationError, RecordingError):
        return None
    for other in beside if np.all(t[np.isfinite(t)] % 1.0 == 0.0) else ():
        with suppress(RecordingError):
            if 0.0 < np.nanmax(np.abs(_rest(source, other)), initial=0.0) < 1.0:
                column = replace(column, nanoseconds=other)
                t = seconds(source, column)
    steps = np.diff(t[np.isfinite(t)])
    if not len(steps) or not np.mean(steps >= 0.0) >= RISING or not np.any(steps > 0.0):
        return None
    if text or source.units.get(name):
        return column
    step, (least, most) = float(np.median(steps[steps > 0.0])), PLAUSIBLE_S
    each = ("s", "ms", "us", "ns", "day")
    likely = (unit for unit in each if least <= step * factor(unit, "s") <= most)
    known = unit_in_title(name, ("s",)) or _epoch(source.numbers(name, gaps=True))
    unit = known or next(likely, None)
    return replace(column, unit=None if unit == "s" else unit)


def disagreement(source: Source, used: Column) -> str | None:
    """What is said of another clock of a source that does not run like the one in use."""
    t = seconds(source, used)
    for other in clocks(source):
        if other.name == source.find(used.name) or len(t) < 3:
            continue
        own = seconds(source, other)
        if not _alike(own, t):
            continue
        apart = own - t - np.nanmedian(own - t)
        period = float(np.nanmedian(np.abs(np.diff(t))))
        if count := int(np.sum(np.abs(apart) > APART * max(period, 1e-3))):
            written = str(other.written).replace("'", "")
            return (
                f"{source.name}: the clocks {used.name} and {other.name} disagree in {count} of "
                f"{len(t)} rows, by up to {np.nanmax(np.abs(apart)):.2g} s; "
                f"columns.time: {written} reads the other"
            )
    return None
