"""Times of a recording: numbers of any unit, seconds with nanoseconds, dates and times of day."""

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.recording.column_map import TITLES as UNIT_TITLES
from seatrial.models.recording.column_map import Column, ColumnMap, factor, unit_in_title, words_of
from seatrial.models.recording.source import MISSING, Source
from seatrial.models.recording.source import column as column_of
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
DATE = re.compile(r"(\d{4}|\d\d?)([./-])(\d\d?)\2(\d{4}|\d\d?)(?!\d)")  # the year first or last
# A date before a time, and a zone, of which only differences matter: as pyarrow searches.
DAY = r"^(\d{4}|\d\d?)[./-](\d\d?)[./-](\d{4}|\d\d?)[T, _]*"
ZONE = r"(\d) ?(?:[A-Za-z]{3,5}|UT|[Zz])$"
DATES = ("ISO8601", "%Y-%m-%d %I:%M:%S %p", "%Y-%m-%d %I:%M:%S.%f %p", "mixed")
CLOCK = re.compile(r"-?\d{1,2}:\d{2}")
# Titles of times, most telling first, with or without a unit.
TITLES = re.compile("(?:" + "|".join((
    r"(time|timestamp|time_stamp|utc|date_?time|stamp|time_utc|utc_time|date|zeit|temps|heure|tid)",
    r"((?:original|elapsed|unix|gps|system|local|log|ros|rec|present|m_present|record)"
    r"_?(?:date)?_?time(?:_?stamp)?)",
    r"(t|ts|(?:time_)?(?:sec|secs|second|seconds)|epoch|utime|tout|index)",
    r"(.*_stamp(?:_sec|_secs)?|(?:.*_)?time(?:stamp)?(?:_.*)?|(?:.*_)?utc(?:_.*)?|(?:gps_|i_?)?tow)",
    r"((?:.*_)?(?:sec|secs|seconds)(?:_of_.*)?)",
)) + ")(?:_(?:s|sec|secs|ms|us|ns|usec|msec))?")  # fmt: skip
MOST_SAMPLES = 100  # on the grid, for each sample of the channel with the most
MIN_STRETCH = 3  # samples of a stretch: a derivative of second order needs as many
TIME_ROUNDING = 1e-6  # of a sample time
AtGap = Literal["refuse", "split"]
APART = 0.5  # of a sample time: two clocks that disagree by more are named


def seconds(source: Source, column: Column) -> Array:
    """Times [s] of the rows of a source, shape (N,); dates since 1970, UTC; NaN where missing.

    A date without a zone is UTC. Numbers without a unit that can only be an epoch in ms, us or ns
    are taken for one. Raises RecordingError if a cell is neither a number nor a date.
    """
    if column in source.times:
        return source.times[column]
    name = source.find(column.name) or column.name
    text = _first_text(source, name)
    if column.format or any(form.match(text) for form in (CLOCK, DATE)):
        times = _of_texts(source, name, column.format)
    else:
        times = source.numbers(name, gaps=True)
        unit = column.unit or source.units.get(name) or unit_in_title(name, ("s",))
        if unit is None and (packed := _packed(times)) is not None:
            times = packed
        else:
            size = factor(unit or _epoch(times) or "s", "s")
            times = _unrolled(times * size, (WORD * size, WEEK_S, DAY_S), 0.95)
    if column.nanoseconds is not None:
        unit = unit_in_title(f"of {column.nanoseconds}", ("s",)) or "ns"
        times = times + source.numbers(column.nanoseconds, gaps=True) * factor(unit, "s")
    if column.date is not None:
        times = seconds(source, Column(column.date)) + times % DAY_S
    if column.uniform and len(times) > 1:
        times = np.linspace(times[0], times[-1], len(times))
    source.times[column] = column.sign * times
    return source.times[column]


def _unrolled(times: Array, periods: Sequence[float], share: float) -> Array:
    """Times (N,) of a counter that starts again at a period, of which it went back `share`."""
    for period in periods:
        steps = np.diff(times, prepend=times[:1])
        times = times + period * np.cumsum((steps < -share * period) & (steps > -1.05 * period))
    return times


def _packed(values: Array) -> Array | None:
    """Numbers such as 235959.5 or 20240507235959 as seconds, (N,); None if they are none."""
    known = values[np.isfinite(values)]
    if not np.any(known) or np.any((known < 0.0) | (known % 100.0 >= 60.0)) or np.ptp(known) <= 40:
        return None
    day, clock = np.divmod(values, 1e6)
    parts = np.array([clock // 1e4, clock // 100.0 % 100.0, clock % 100.0])
    start = np.zeros(len(values))
    if np.min(known) >= 1e6:
        start = _since_1970(pd.Series(day).map("{:.0f}".format), ("%Y%m%d",))
    if np.all(np.isnan(start)) or np.any(np.nanmax(parts, axis=1) >= (24.0, 60.0, 60.0)):
        return None
    return _unrolled(start + np.array([3600.0, 60.0, 1.0]) @ parts, (DAY_S,), 0.5)


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


def _of_texts(source: Source, name: str, form: str | None) -> Array:
    """Dates, or times of day with midnight passed, as seconds.

    Of dates with the year last, the order of day and month is the one that fits all days.
    """
    text = _first_text(source, name)
    cells = pd.Series(source.columns[name]).astype("str").str.strip()
    texts = cells.mask(cells.str.lower().isin(MISSING))
    plain = texts.str.replace(ZONE, r"\1", regex=True)
    if form is not None:
        times = _since_1970(texts, (form, form.removesuffix(".%f")))  # without a fraction
    elif CLOCK.match(text):
        whole = plain.str.replace(",", ".")
        whole = whole.where(whole.str.count(":") != 1, whole + ":00")
        times = pd.to_timedelta(whole, errors="coerce").dt.total_seconds().to_numpy(copy=True)
        times = _unrolled(times, (DAY_S,), 0.5)
    else:
        first, sign, _, last = DATE.findall(text)[0]
        year = r"\3" if len(last) == 4 else r"20\3"
        orders = [rf"{year}-\2-\1 ", rf"{year}-\1-\2 "] if len(first) < 4 else [r"\1-\2-\3 "]
        days = texts.str.slice(0, 10).drop_duplicates().str.extract(f"({DAY})")[0].drop_duplicates()
        tried = (days.str.replace(DAY, order, regex=True).str.strip() for order in orders)
        lost = [int(np.sum(np.isnan(_since_1970(each, DATES[:1])))) for each in tried]
        if sign != "." and len(lost) == 2 and lost[0] == lost[1] < len(days):
            known = DATE.sub(r"25\g<2>12\g<2>2024", text, count=1)
            guess = pd.tseries.api.guess_datetime_format(known, dayfirst=True)
            guess = guess or f"%d{sign}%m{sign}%Y %I:%M:%S %p"
            guess = guess if len(last) == 4 else guess.replace("%Y", "%y")
            raise RecordingError(
                f"{source.path}, column {name}: got {text!r}, is the day or the month first? "
                f"columns.time: {{column: {name}, format: '{guess}'}}"
            )
        dates = plain.where(plain.str.match(DAY))
        written = dates.str.replace(DAY, orders[int(np.argmin(lost))], regex=True)
        times = _since_1970(written.str.strip(), DATES)
    wrong = np.isnan(times) & texts.notna().to_numpy()
    if np.sum(wrong) >= 0.5 * np.sum(texts.notna()):  # few others stand for no time
        row = int(np.argmax(wrong))
        expected = f"a date and time such as {form or '2025-04-11T11:51:09.416Z'}"
        raise source.refused(row, name, expected)
    return np.asarray(times, dtype=np.float64)


def _since_1970(texts: "pd.Series[str]", forms: Sequence[str]) -> Array:
    """Dates as seconds (N,), each by the first of the formats that fits it; NaN where none does."""
    times = np.full(len(texts), np.nan)
    for form in forms:
        left = np.isnan(times) & texts.notna().to_numpy()
        stamps = pd.to_datetime(texts[left], format=form, utc=True, errors="coerce")
        known = stamps.astype("datetime64[ns, UTC]").astype(np.int64).to_numpy() * 1e-9
        times[left] = np.where(stamps.isna(), np.nan, known)
    return times


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
    known = clocks(source)
    steady = [(column, t) for column, t in known if not np.any(np.diff(t) < 0.0)] or known[:1]
    repeats = [float(np.mean(np.diff(t) == 0.0)) for _, t in steady]
    for (column, t), share in zip(steady, repeats, strict=True):
        if share < 0.5 * repeats[0] > 0.5 * (1.0 - RISING) and _alike(t, steady[0][1]):
            return column
    return steady[0][0] if steady else None


def _alike(t: Array, other: Array) -> bool:
    """Whether columns (N,) [s] last equally long, as two times of the same rows do."""
    own, beside = (np.ptp(each[np.isfinite(each)]) for each in (t, other))
    return bool(0.9 * beside < own < 1.1 * beside)


def clocks(source: Source) -> list[tuple[Column, Array]]:
    """The columns of a source that are times by their titles, and rise, in s (N,).

    They have what else is needed to read them; the most telling title is first.
    """
    titles = {name: "_".join(words_of(name)) for name in source.columns}
    named, ranks = {title: name for name, title in titles.items()}, dict[str, int]()
    for name, title in titles.items():
        match = TITLES.fullmatch(title)
        if match or DATE.match(_first_text(source, name)):
            ranks[name] = (match.lastindex if match else None) or TITLES.groups + 1
    known = list[tuple[Column, Array]]()
    for name in sorted(ranks, key=lambda name: ranks[name]):
        text, stem = _first_text(source, name), re.sub(r"(secs?|time|date)$", "", titles[name])
        days = (named.get(title, name) for title in (f"{stem}date", "date", "day"))
        day = next((other for other in days if other != name), None)
        column = Column(name, date=day if CLOCK.match(text) else None)
        if text and not set(text) & set(":T"):
            continue  # a day without its time
        try:
            t = seconds(source, column)
            if np.all(t[np.isfinite(t)] % 1.0 == 0.0):
                rests = (f"{stem.strip('_')}_{word}".strip("_") for word in RESTS)
                tried = (replace(column, nanoseconds=named[r]) for r in rests if r in named)
                fits = (c for c in tried if 0.0 < np.nanmax(seconds(source, c) - t, initial=0) < 1)
                column = next(fits, column)
        except (ConfigurationError, RecordingError):
            continue
        steps = np.diff(t[np.isfinite(t)])
        if not np.any(steps > 0.0) or np.mean(steps >= 0.0) < RISING:
            continue
        if not text and not source.units.get(name):
            step, (least, most) = float(np.median(steps[steps > 0.0])), PLAUSIBLE_S
            each = ("s", "ms", "us", "ns", "day")
            likely = (unit for unit in each if least <= step * factor(unit, "s") <= most)
            unit = unit_in_title(name, ("s",)) or _epoch(source.numbers(name, gaps=True))
            unit = unit or next(likely, None)
            column = replace(column, unit=None if unit == "s" else unit)
        known.append((column, seconds(source, column)))
    return known


def disagreement(source: Source, used: Column) -> str | None:
    """What is said of another clock of a source that does not run like the one in use."""
    t, name = seconds(source, used), source.find(used.name)
    for other, own in clocks(source) if len(t) > 2 else ():
        if other.name == name or not _alike(own, t):
            continue
        apart = np.abs(own - t - np.nanmedian(own - t))
        period = float(np.nanmedian(np.abs(np.diff(t))))
        if count := int(np.sum(apart > APART * max(period, 1e-3))):
            written = str(other.written).replace("'", "")
            return (
                f"{source.name}: the clocks {used.name} and {other.name} disagree in {count} of "
                f"{len(t)} rows, by up to {np.nanmax(apart):.2g} s; "
                f"columns.time: {written} reads the other"
            )
    return None


def clock_of(source: Source, columns: ColumnMap) -> Column:
    """The time of a source: that of the map, which may be named `source:column`, or its own."""
    time = columns.clock
    for name in (time.name, time.name.rpartition(":")[2]):
        if source.find(name) is not None:
            return replace(time, column=name)
    known = find_time(source)
    return known or replace(time, column=column_of({source.name: source}, time.name)[1])  # raises


class Channel(NamedTuple):
    """A signal on its own clock: a state is interpolated, a command held until the next."""

    t: Array  # (N,) [s], increasing
    values: Array  # (N,)
    held: bool = False
    name: str = ""  # for messages

    def cleaned(self, notes: list[str]) -> "Channel":
        """Without missing values, and samples that are not later than all before; `notes` tell."""
        timeless = np.isnan(self.t)
        if np.any(timeless):
            notes.append(f"{np.sum(timeless)} rows have no time: left out")
        valid = ~(np.isnan(self.values) | timeless)
        t, values = self.t[valid], self.values[valid]
        if not np.all(later := is_later(t)):
            back, same = np.sum(np.diff(t) < 0.0), np.sum(np.diff(t) == 0.0)
            text = f"not later than the one before ({same} times repeat, {back} go back): left out"
            notes.append(f"{self.name}: {np.sum(~later)} samples are {text}")
        return self._replace(t=t[later], values=values[later])


Channels = dict[str, Channel]  # by option


def join_channels(
    channels: Channels, rate_hz: float, max_gap_s: float, at_gap: AtGap = "refuse"
) -> tuple[Array, dict[str, Array]]:
    """Interpolate states linearly, and hold commands, on one uniform grid of times (n,) [s].

    The grid starts where the last channel starts and ends where the first one ends. A time longer
    than `max_gap_s` [s] without a sample of one of the channels is a gap: `refuse` raises
    RecordingError, `split` leaves it out of the grid. The channels have no missing values, and
    angles are unrolled. There is no anti-aliasing filter.
    """
    if short := next((c for c in channels.values() if len(c.t) < 2), None):
        raise RecordingError(f"{short.name}: got {len(short.t)} samples, expected at least 2")
    start, last = max((float(c.t[0]), c.name) for c in channels.values())
    end, first = min((float(c.t[-1]) + max_gap_s * c.held, c.name) for c in channels.values())
    stop = min(end, max(float(c.t[-1]) for c in channels.values()))
    count = int(np.floor((stop - start) * rate_hz * (1.0 + 1e-12) + 1e-9)) + 1
    if count > MOST_SAMPLES * (most := max(len(channel.t) for channel in channels.values())):
        got = f"got {count:.3g} samples from the {most} recorded, at resample_hz={rate_hz:g}"
        raise RecordingError(f"{got}; expected at most {MOST_SAMPLES} times as many")
    rows = np.arange(count)  # of the grid, without those in gaps of the channels before
    for channel in channels.values():
        t = start + rows / rate_hz
        before = channel.t[np.searchsorted(channel.t, t, side="right") - 1]
        after = np.minimum(np.searchsorted(channel.t, t), len(channel.t) - 1)  # or on a sample
        length = (t if channel.held else channel.t[after]) - before
        gaps = length > max_gap_s * (1.0 + TIME_ROUNDING)
        if at_gap == "refuse" and np.any(gaps):
            k = int(np.argmax(gaps))
            got = f"got no sample for {length[k]:.6g} s after {before[k]:.6g} s"
            expected = f"expected at most {max_gap_s:g} s; excitation.at_gap=split leaves gaps out"
            raise RecordingError(f"{channel.name}: {got}, {expected}")
        rows = rows[~gaps]
    stretches = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
    rows = np.concatenate([part if len(part) >= MIN_STRETCH else part[:0] for part in stretches])
    if not len(rows):
        got = f"got no {MIN_STRETCH} samples at {rate_hz:g} Hz that all columns cover"
        raise RecordingError(f"{got}: {last} begins at {start:g} s, {first} ends at {stop:g} s")
    t, values = start + rows / rate_hz, dict[str, Array]()
    for option, channel in channels.items():
        now = np.searchsorted(channel.t, t + TIME_ROUNDING / rate_hz, side="right") - 1
        between = np.interp(t, channel.t, channel.values)
        values[option] = channel.values[now] if channel.held else between
    return t, values
