"""Which column is what by how they move together, and units of angles and speeds.

Time increases by equal steps. The path is the pair of columns whose course follows a third, the
heading, and the heading is the one of these that has a column of its rate. Velocities are the
columns that follow the derivative of the path, along the axes of the body or of the earth. The
rudder explains the yaw acceleration best beside the yaw rate (Nomoto's equation of first order).
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from seatrial.models.errors import RecordingError
from seatrial.models.recording.consistency import correlations
from seatrial.models.recording.source import Source
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import unroll

MIN_SAMPLES = 50  # samples
EVEN = 0.5  # largest distance of times from equal steps, relative to the step
ROUNDED = 0.01  # the same of times that are written with few digits, relative to the last
ALIKE = 0.95  # correlation of a column with what it is taken for
STEADY = 3.0  # standard deviations of a mean that exceeds the variation
FACTOR_TOLERANCE = 0.1  # deviation of a factor from that of a unit
MAX_DRIFT = 0.7  # largest deviation of the course from the heading, relative to the heading's
SPAN = 0.01  # share of the samples over which differences are taken, so that noise averages out
LEAST = 1e-9  # of a deviation: a column that varies less is constant
MOST_COLUMNS = 40
RESTING_SHARE = 0.02  # of its largest step: a column that changes less rests
SAMPLES = 400  # of the path that are compared
TOGETHER = 0.7  # least concentration of course less heading
STEP_S = 5.0  # [s] of a path whose length is compared with a speed
BETTER = 0.5  # of what is left of it in the other unit
DEG, KNOT = np.pi / 180.0, 1852.0 / 3600.0
TURNS, RATES, SPEEDS = {"rad": 1.0, "deg": DEG}, {"": 1.0, "deg/s": DEG}, {"": 1.0, "knot": KNOT}
GROUND = {"m/s": 1.0, "knot": KNOT, "km/h": 1.0 / 3.6}
Found = tuple[str, str]  # a column and its unit, "" for that of SI
Path = tuple[Array, Array, Array]  # times [s] and positions along two axes, shape (N,) each


@dataclass(frozen=True)
class _Moving:
    """Columns of numbers (N,) that move, on even times."""

    period_s: float
    columns: Mapping[str, Array]

    @property
    def span(self) -> int:
        return max(1, round(SPAN * len(next(iter(self.columns.values()), ()))))

    def change(self, values: Array) -> Array:
        """The mean rate of change over the span."""
        return np.asarray((values[self.span :] - values[: -self.span]) / self.span / self.period_s)

    def mean(self, values: Array) -> Array:
        """The mean over the span, which is the rate of change of the integral."""
        total = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]))])
        return np.asarray((total[self.span :] - total[: -self.span]) / self.span)

    def like(self, rate: Array, units: Mapping[str, float], names: Iterable[str]) -> Found | None:
        """The column, and its unit, whose mean is a rate of change; None if there is none."""
        best, most = None, ALIKE
        for name in names:
            mean = self.mean(self.columns[name])
            # about zero: a speed that hardly varies is known by its mean alone
            scale = float(mean @ rate) / max(float(mean @ mean), LEAST)
            near = [u for u, size in units.items() if abs(scale / size - 1.0) < FACTOR_TOLERANCE]
            if abs(np.mean(rate)) > STEADY * np.std(rate):
                rho = float(mean @ rate / (np.linalg.norm(mean) * np.linalg.norm(rate) + LEAST))
            else:
                rho = float(correlations(mean[:, None], rate[:, None])[0, 0])
            if rho > most and near:
                best, most = (name, near[0]), rho
        return best


def propose_by_motion(source: Source) -> dict[str, object]:
    """A map of the columns of one file without names.

    Raises RecordingError if no column is a time, or no columns are a path with its heading.
    """
    time, moving = _moving(source)
    path = _path(moving)
    if path is None:
        raise RecordingError(
            f"{source.path}: no columns of a position and a heading that belong together, expected "
            "a column of time named as one, such as t or time_s, or names by excitation.text.names"
        )
    x, y, psi, turn = path
    heading = moving.columns[psi] * TURNS[turn]
    rest = [name for name in moving.columns if name not in (x, y, psi)]
    rates = np.array([moving.change(moving.columns[name]) for name in (x, y)])
    cos, sin = np.cos(moving.mean(heading)), np.sin(moving.mean(heading))
    along = np.array([rates[0] * cos + rates[1] * sin, rates[1] * cos - rates[0] * sin])
    body, earth = ({dof: known for dof, rate in zip(("surge", "sway"), axes, strict=True)
                    if (known := moving.like(rate, SPEEDS, rest))}
                   for axes in (along, rates))  # fmt: skip
    by_earth = len(body) < 2 and len(earth) == 2
    velocity = earth if by_earth else body or earth
    if yaw := moving.like(moving.change(heading), RATES, rest):
        velocity["yaw"] = yaw
    taken = {column for column, _ in velocity.values()}
    rudder = _rudder(moving, heading, [name for name in rest if name not in taken])
    large = rudder and turn == "deg" and np.max(np.abs(moving.columns[rudder])) > np.pi / 2.0

    def written(name: str, unit: str) -> object:
        return {"column": name, "unit": unit} if unit not in ("", "rad") else name

    groups: dict[str, object] = {
        "time": time,
        "position": {"surge": x, "sway": y, "yaw": written(psi, turn)},
        "velocity": {dof: written(*column) for dof, column in velocity.items()},
        "frames": {"velocity": "earth"} if by_earth else {},
        "inputs": {"delta": written(rudder, "deg" if large else "")} if rudder else {},
    }
    return {name: group for name, group in groups.items() if group}


def angle_unit(path: Path, times: Array, heading: Array) -> str | None:
    """The unit of a heading, rad or deg: that in which the course keeps with it; None: unclear.

    Args:
        path: times [s] and positions along two axes (N,)
        times: of the heading [s], shape (M,)
        heading: angles, shape (M,)
    """
    best, most = None, TOGETHER
    for every in 4 ** np.arange(8):  # short steps are noise, long ones hide the turns
        t, x, y = (values[::every] for values in path)
        middle = np.searchsorted(times, 0.5 * (t[1:] + t[:-1])).clip(0, len(times) - 1)
        step = np.diff(x) + 1j * np.diff(y)
        step /= max(float(np.sum(np.abs(step))), LEAST)
        turns = {unit: np.exp(1j * size * heading[middle]) for unit, size in TURNS.items()}
        kept = {u: float(max(abs(z @ step), abs(z.conj() @ step))) for u, z in turns.items()}
        unit = max(kept, key=lambda name: kept[name])
        clear = len(t) > MIN_SAMPLES and 1.0 - kept[unit] < BETTER * (1.0 - min(kept.values()))
        if clear and kept[unit] > most:
            best, most = unit, kept[unit]
    return best


def speed_unit(path: Path, times: Array, speed: Array) -> str | None:
    """The unit of a speed over ground in which it makes the length of the path; None: none."""
    t, x, y = path
    every = max(1, round(STEP_S / max(float(np.median(np.diff(t))), LEAST)))
    length = float(np.sum(np.hypot(np.diff(x[::every]), np.diff(y[::every]))))
    size = length / (float(np.sum(speed[1:] * np.diff(times))) + LEAST)
    return next((u for u, k in GROUND.items() if abs(size / k - 1.0) < FACTOR_TOLERANCE), None)


def _moving(source: Source) -> tuple[object, _Moving]:
    """The column of time, as in a map, and the others that move."""
    columns = {}
    for name in list(source.columns)[:MOST_COLUMNS]:
        try:
            columns[name] = source.numbers(name)
        except RecordingError:
            continue
    for name, values in columns.items():
        if len(values) < MIN_SAMPLES or not np.all(np.diff(values) >= 0.0):
            continue
        even = np.linspace(values[0], values[-1], len(values))
        apart, period = float(np.max(np.abs(values - even))), float(even[1] - even[0])
        if period > 0.0 and apart < max(EVEN * period, ROUNDED * abs(values[-1])):
            written = name if apart < EVEN * period else {"column": name, "uniform": True}
            others = {n: v for n, v in columns.items() if n != name and np.std(v) > LEAST}
            return written, _Moving(period, others)
    raise RecordingError(
        f"{source.path}: no column of time among {', '.join(source.columns)[:300]}, expected one "
        "that increases by equal steps, or one such as t or time"
    )


def _path(moving: _Moving) -> tuple[str, str, str, str] | None:
    """North, east, heading and its unit: those whose course keeps closest to the heading."""
    rates = {name: moving.change(values) for name, values in moving.columns.items()}
    every = max(1, len(next(iter(rates.values()), ())) // SAMPLES)
    best, least = None, MAX_DRIFT
    for psi, (unit, size) in ((psi, turn) for psi in rates for turn in TURNS.items()):
        others = set(rates) - {psi}
        if moving.like(rates[psi] * size, RATES, others) is None:
            continue
        heading = moving.mean(moving.columns[psi] * size)[::every]
        for x, y in permutations(others, 2):
            drift = unroll(np.arctan2(rates[y][::every], rates[x][::every])) - heading
            drift -= 2.0 * np.pi * np.round(np.mean(drift) / (2.0 * np.pi))
            ratio = float(np.sqrt(np.mean(drift**2)) / max(np.std(heading), LEAST))
            if ratio < least:
                best, least = (x, y, psi, unit), ratio
    return best


def _rudder(moving: _Moving, heading: Array, rest: Iterable[str]) -> str | None:
    """The column that leaves least of the yaw acceleration, beside the yaw rate.

    Roll and thrust follow the turn as well, but never rest: of each column the share of samples in
    which it moves counts too.
    """
    rate = moving.change(heading)
    target, own = moving.change(rate), moving.mean(rate)
    best, least = None, ALIKE * float(np.sum((target - np.mean(target)) ** 2))
    for name in rest:
        values = moving.columns[name]
        basis = np.column_stack([np.ones_like(own), own, moving.mean(moving.mean(values))])
        error = target - basis @ np.linalg.lstsq(basis, target, rcond=None)[0]
        steps = np.abs(np.diff(values))
        left = float(error @ error) * float(np.mean(steps > RESTING_SHARE * np.max(steps)))
        if left < least:
            best, least = name, left
    return best
