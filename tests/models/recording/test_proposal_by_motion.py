"""Columns without names are told apart by how they move."""

from pathlib import Path

import numpy as np
import pytest

from seatrial.models.errors import RecordingError
from seatrial.models.recording.proposal import propose
from seatrial.models.recording.proposal_by_motion import angle_unit, propose_by_motion, speed_unit
from seatrial.models.recording.source import Source
from seatrial.models.recording.sources import ReadOptions, read_sources
from seatrial.models.vessel.basis import Array
from tests.data import DATA

PERIOD = 0.1
COLUMNS = ("t", "x", "y", "psi", "u", "v", "r", "delta", "n")


def _zigzag(sway: float = -1.5) -> dict[str, Array]:
    """A ship of first order in a zig-zag: T r' + r = K delta, and v = `sway` r."""
    t = PERIOD * np.arange(3000)
    delta = np.radians(10.0) * np.clip(8.0 * np.sin(0.08 * t), -1.0, 1.0)
    r = np.zeros_like(t)
    for k in range(len(t) - 1):
        r[k + 1] = r[k] + PERIOD * (0.12 * delta[k] - r[k]) / 6.0
    psi = np.concatenate([[0.0], np.cumsum(0.5 * PERIOD * (r[1:] + r[:-1]))]) + 0.4
    u, v = 2.0 + 0.0 * t - 5.0 * r**2, sway * r
    rates = u * np.cos(psi) - v * np.sin(psi), u * np.sin(psi) + v * np.cos(psi)
    x, y = (np.concatenate([[0.0], np.cumsum(0.5 * PERIOD * (d[1:] + d[:-1]))]) for d in rates)
    return {"t": t, "x": x, "y": y, "psi": psi, "u": u, "v": v, "r": r, "delta": delta,
            "n": np.full_like(t, 3.0), "dx": rates[0], "dy": rates[1]}  # fmt: skip


def _source(columns: list[Array]) -> Source:
    names = [f"c{k + 1}" for k in range(len(columns))]
    return Source("log", Path("log.dat"), dict(zip(names, columns, strict=True)))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("degrees", [False, True])
@pytest.mark.parametrize("earth", [False, True])
def test_columns_in_any_order(seed: int, degrees: bool, earth: bool) -> None:
    known = _zigzag()
    if earth:
        known |= {"u": known["dx"], "v": known["dy"]}
    if degrees:
        known |= {name: np.degrees(known[name]) for name in ("psi", "r", "delta")}
    order = np.random.default_rng(seed).permutation(len(COLUMNS))
    place = {COLUMNS[k]: f"c{i + 1}" for i, k in enumerate(order)}
    known["t"] = known["t"] + 0.001  # the clock does not begin at zero
    proposed = propose_by_motion(_source([known[COLUMNS[k]] for k in order]))

    def angle(name: str, unit: str) -> object:
        return {"column": place[name], "unit": unit} if degrees else place[name]

    delta = {"column": place["delta"], "unit": "deg"} if degrees else place["delta"]
    assert proposed == {
        "time": place["t"],
        "position": {"surge": place["x"], "sway": place["y"], "yaw": angle("psi", "deg")},
        "velocity": {"surge": place["u"], "sway": place["v"], "yaw": angle("r", "deg/s")},
        **({"frames": {"velocity": "earth"}} if earth else {}),
        "inputs": {"delta": delta},
    }


def test_knots() -> None:
    known = _zigzag()
    columns = [known[name] for name in ("t", "x", "y", "psi", "r", "delta")]
    proposed = propose_by_motion(_source([*columns, known["u"] * 3600.0 / 1852.0]))
    assert proposed["velocity"] == {"surge": {"column": "c7", "unit": "knot"}, "yaw": "c5"}


def test_what_does_not_belong_together_is_refused() -> None:
    rng = np.random.default_rng(1)
    t = PERIOD * np.arange(500)
    noise = [rng.standard_normal(500) for _ in range(5)]
    with pytest.raises(RecordingError, match="no columns of a position and a heading"):
        propose({"log": _source([t, *noise])})
    with pytest.raises(RecordingError, match="no column of time among c1, c2"):
        propose({"log": _source(noise)})


@pytest.mark.data
@pytest.mark.slow
@pytest.mark.parametrize("name", ["hsva", "marin"])
def test_the_basins_of_the_kvlcc2(name: str) -> None:
    """Every file of a basin has the columns that its map in docs/howto/recordings.md states."""
    files = sorted((DATA / "kvlcc2" / name).glob("*.dat"))
    time = {"hsva": "c1", "marin": {"column": "c1", "uniform": True}}[name]
    heading = {"hsva": "c4", "marin": "c5"}[name]
    for file in files:
        proposed = propose(read_sources(file, ReadOptions())).map
        assert proposed["time"] == time
        yaw = {"column": heading, "unit": "deg"}
        assert proposed["position"] == {"surge": "c2", "sway": "c3", "yaw": yaw}
        velocity = proposed["velocity"]
        assert isinstance(velocity, dict)
        rate = {"hsva": "c7", "marin": "c9"}[name]
        assert velocity["yaw"] == {"column": rate, "unit": "deg/s"}
        rudder = {"hsva": "c9", "marin": "c10"}[name]
        assert proposed["inputs"] == {"delta": {"column": rudder, "unit": "deg"}}
    assert files


@pytest.mark.parametrize("unit", ["rad", "deg"])
@pytest.mark.parametrize("turned", [False, True])
def test_the_unit_of_a_heading_by_the_course(unit: str, turned: bool) -> None:
    """Also where it counts the other way, and not where the path says nothing of it."""
    known = _zigzag()
    heading = known["psi"] * (180.0 / np.pi if unit == "deg" else 1.0) * (-1.0 if turned else 1.0)
    path = (known["t"], known["x"], known["y"])
    assert angle_unit(path, known["t"], heading) == unit
    noise = 0.3 * np.random.default_rng(2).standard_normal((2, len(heading)))
    assert angle_unit((path[0], path[1] + noise[0], path[2] + noise[1]), path[0], heading) == unit
    still = (known["t"], np.zeros_like(heading), np.zeros_like(heading))
    assert angle_unit(still, known["t"], heading) is None


def test_the_unit_of_the_heading_of_a_long_recording() -> None:
    """Many turns in every hundredth of it."""
    t = 0.05 * np.arange(200_000)
    psi = np.cumsum(0.05 * 0.06 * np.sin(0.05 * t))
    x, y = np.cumsum(0.1 * np.cos(psi)), np.cumsum(0.1 * np.sin(psi))
    assert angle_unit((t, x, y), t, np.degrees(psi)) == "deg"
    assert speed_unit((t, x, y), t, 2.0 * 3.6 + 0.0 * t) == "km/h"


@pytest.mark.parametrize(("unit", "size"), [("m/s", 1.0), ("knot", 1.943844), ("km/h", 3.6)])
def test_the_unit_of_a_speed_by_the_path(unit: str, size: float) -> None:
    known = _zigzag()
    path = (known["t"], known["x"], known["y"])
    speed = np.hypot(known["dx"], known["dy"])
    assert speed_unit(path, known["t"], size * speed) == unit
    assert speed_unit(path, known["t"], 2.9 * speed) is None
