"""`animate`: hull, thrust and rudder of a run as a film."""

import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.patches import Polygon
from PIL import Image

from seatrial.runner.compare import animation
from seatrial.runner.compare.animation import BLADE, film_of, parts_of, turning_side
from seatrial.runner.compare.frame import open_results
from seatrial.runner.compare.plots import style
from seatrial.runner.compare.plots.track import in_ned
from seatrial.runner.record.rows import Series
from tests.runner.compare import stored
from tests.runner.compare.conftest import Program
from tests.runner.compare.test_command_line import database

T = np.arange(0.0, 60.0, 0.1)
VESSEL = {
    "length_m": 10.0,
    "inputs": {"delta": {"low": -0.6, "high": 0.6}, "n": {"low": 0.0, "high": 3.0}},
    "devices": {"propeller": {"n": "n"}, "rudder": {"delta": "delta"}},
}


def steered(gain: float) -> Series:
    """Nomoto's ship, 3 r' + r = gain delta, under a rudder of 20 degrees that changes sides."""
    delta = np.radians(20.0) * np.sign(np.sin(0.3 * T))
    r = np.zeros_like(T)
    for k in range(len(T) - 1):
        r[k + 1] = r[k] + 0.1 * (gain * delta[k] - r[k]) / 3.0
    psi = 0.1 * np.cumsum(r)
    columns = {"t": T, "psi": psi, "r": r, "delta": delta, "n": np.full_like(T, 1.5)}
    columns |= {"x": 0.3 * np.cumsum(np.cos(psi)), "y": 0.3 * np.cumsum(np.sin(psi))}
    return stored.series("recording", columns)


@pytest.fixture(scope="module")
def ship(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("ship")
    with stored.logbook_at(folder) as logbook:
        begin = stored.start("none", config={"vessel": VESSEL})
        stored.finish(logbook, begin, series=[steered(0.4)])
        without = stored.series("recording", {"t": T, "x": T, "psi": 0.0 * T})
        stored.finish(logbook, stored.start("none", seed=1), series=[without])
    return folder


@pytest.mark.parametrize("gain", [0.4, -0.4])
def test_a_rudder_lies_to_the_side_to_which_the_ship_turns(gain: float) -> None:
    series = steered(gain)
    assert turning_side(series, series.columns["delta"]) == np.sign(gain)
    ((rudder, shaft),) = parts_of([series], VESSEL, 10.0)
    blade = rudder.end - rudder.start
    np.testing.assert_allclose(np.hypot(*blade.T), BLADE * 10.0)
    np.testing.assert_allclose(rudder.start, np.tile([-5.0, 0.0], (len(T), 1)))
    assert np.all(blade[:, 0] <= 0.0)  # it trails
    acceleration = np.gradient(series.columns["r"], T)
    turning = np.abs(acceleration) > 0.01
    assert np.all((blade[:, 1] * acceleration)[turning] > 0.0)
    np.testing.assert_allclose(shaft.start, rudder.start)
    np.testing.assert_allclose(shaft.end - shaft.start, np.tile([0.5 * 8.0, 0.0], (len(T), 1)))


def test_thrusters_push_where_they_are_and_where_they_point() -> None:
    columns = {"t": T, "pwm_1": np.ones_like(T), "alpha_1": np.full_like(T, 0.5 * np.pi)}
    series = stored.series("recording", columns)
    inputs = {"pwm_1": {"low": -1.0, "high": 1.0}, "alpha_1": {"low": -3.2, "high": 3.2}}
    device = {"drive": "pwm_1", "alpha": "alpha_1", "x_m": 1.8, "y_m": -0.8}
    vessel = {"length_m": 5.0, "inputs": inputs, "devices": {"azimuth": device}}
    for hull in (5.0, 50.0):  # also of a hull that is drawn ten times as long
        ((thrust,),) = parts_of([series], vessel, hull)
        np.testing.assert_allclose(thrust.start[0], [1.8 * hull / 5.0, -0.8 * hull / 5.0])
        np.testing.assert_allclose((thrust.end - thrust.start)[0], [0.0, 0.8 * hull], atol=1e-9)


def test_forces_share_a_scale_and_turn_with_the_hull() -> None:
    ahead = {"t": T, "tau_surge": 0.0 * T + 50.0}
    pair = [
        stored.series("deployment", ahead | {"tau_sway": 0.0 * T + sway}) for sway in (500.0, 100.0)
    ]
    (first,), (second,) = parts_of(pair, {}, 10.0)
    ends = np.array([first.start[7], first.end[7]])
    body = ends[1] - ends[0]
    np.testing.assert_allclose(body, [0.8, 8.0])  # 0.8 L for the largest
    np.testing.assert_allclose(second.end[7], [0.8, 1.6])
    ahead_is_north = in_ned(ends, 0.0, 0.0, 0.0)
    np.testing.assert_allclose(ahead_is_north[1], body[::-1])  # east is starboard
    ahead_is_east = in_ned(ends, 3.0, 2.0, 0.5 * np.pi)
    np.testing.assert_allclose(ahead_is_east[1], [2.0 + body[0], 3.0 - body[1]], atol=1e-9)


def test_the_hull_is_on_the_track_and_to_scale(ship: Path) -> None:
    """At its last frame, the ship is where the last sample is."""
    with open_results(f"sqlite:///{ship}/results.db") as results, style.drawn():
        film = film_of(results, 1, 12)
        hull = film._func(len(T) - 1)[0]  # type: ignore[attr-defined]
        film._draw_was_started = True  # or matplotlib warns that nothing was shown
    assert isinstance(hull, Polygon)
    bow, stern = hull.get_xy()[0], hull.get_xy()[2:4].mean(axis=0)
    columns = steered(0.4).columns
    east, north, psi = (columns[name][-1] for name in ("y", "x", "psi"))
    np.testing.assert_allclose(bow - stern, 10.0 * np.array([np.sin(psi), np.cos(psi)]))
    np.testing.assert_allclose(0.5 * (bow + stern), [east, north])


@pytest.mark.parametrize("form", [".html", ".gif", ".mp4"])
def test_a_film_moves(
    program: Program, ship: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, form: str
) -> None:
    if form == ".mp4" and shutil.which("ffmpeg") is None:
        pytest.skip("no ffmpeg: apt-get install ffmpeg")
    monkeypatch.setitem(animation.FRAMES, form, 6)
    file = tmp_path / "new" / f"a{form}"
    assert program("animate", "1", *database(ship), "--to", file)[:2] == (0, f"{file}\n")
    if form == ".html":  # which holds its pictures, and needs no network
        text = file.read_text(encoding="utf-8")
        pictures: list[Any] = [line for line in text.splitlines() if "data:image/png" in line]
        assert "://" not in text
    elif form == ".gif":
        with Image.open(file) as film:
            pictures = []
            for k in range(film.n_frames):  # type: ignore[attr-defined]
                film.seek(k)
                pictures.append(film.convert("RGB").tobytes())
    else:
        words = ["ffmpeg", "-loglevel", "error", "-i", file, tmp_path / "%03d.png"]
        subprocess.run(words, check=True)
        pictures = [Image.open(png).tobytes() for png in sorted(tmp_path.glob("*.png"))]
    assert len(pictures) == len(set(pictures)) == 6


def test_what_cannot_be_shown_is_refused_in_one_line(
    program: Program, ship: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "which", lambda _: None)
    for run, name, message in (
        ("1", "a.png", "expected the ending .html, .gif or .mp4"),
        ("1", "a.mp4", "needs the program ffmpeg"),
        ("999", "a.html", "999"),
        ("2", "a.html", "animate: run 2 has no y"),
    ):
        code, _, err = program("animate", run, *database(ship), "--to", tmp_path / name)
        assert (code, len(err.splitlines())) == (2, 1)
        assert message in err
    assert list(tmp_path.iterdir()) == []
