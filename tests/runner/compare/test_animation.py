"""`animate`: hull, thrust and rudder of a run, as a page and as a film."""

import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare import animation
from seatrial.runner.compare.results import Results, open_results
from seatrial.runner.compare.scene import BLADE, parts_of, scene_of, turning_side
from seatrial.runner.record.rows import Series
from tests.runner.compare import stored
from tests.runner.compare.browsers import complaints, open_page
from tests.runner.compare.conftest import Program
from tests.runner.compare.test_command_line import database

T = np.arange(0.0, 60.0, 0.1)


def steered(gain: float) -> Series:
    """Nomoto's ship, 3 r' + r = gain delta, under a rudder of 20 degrees that changes sides."""
    delta = np.radians(20.0) * np.sign(np.sin(0.3 * T))
    r = np.zeros_like(T)
    for k in range(len(T) - 1):
        r[k + 1] = r[k] + 0.1 * (gain * delta[k] - r[k]) / 3.0
    psi = 0.1 * np.cumsum(r)
    columns = {"t": T, "psi": psi, "r": r, "delta": delta, "n": np.full_like(T, 1.5)}
    columns |= {"x": 0.3 * np.cumsum(np.cos(psi)), "y": 0.3 * np.cumsum(np.sin(psi))}
    units = {"t": "s", "psi": "rad", "r": "rad/s", "delta": "", "n": "", "x": "m", "y": "m"}
    return Series("recording", columns, units)


VESSEL = {
    "length_m": 10.0,
    "inputs": {"delta": {"low": -0.6, "high": 0.6}, "n": {"low": 0.0, "high": 3.0}},
    "devices": {"propeller": {"n": "n"}, "rudder": {"delta": "delta"}},
}


@pytest.fixture(scope="module")
def ship(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("ship")
    with stored.logbook_at(folder) as logbook:
        begin = stored.start("none", config={"vessel": VESSEL})
        stored.finish(logbook, begin, series=[steered(0.4)])
    return folder


@pytest.mark.parametrize("gain", [0.4, -0.4])
def test_a_rudder_lies_to_the_side_to_which_the_ship_turns(gain: float) -> None:
    series = steered(gain)
    assert turning_side(series, series.columns["delta"]) == np.sign(gain)
    ((rudder, _),) = parts_of([series], VESSEL, 10.0)
    blade = rudder.end - rudder.start
    np.testing.assert_allclose(np.hypot(*blade.T), BLADE * 10.0)
    np.testing.assert_allclose(rudder.start, np.tile([-5.0, 0.0], (len(T), 1)))
    assert np.all(blade[:, 0] <= 0.0)  # it trails
    turning = np.abs(np.gradient(series.columns["r"], T)) > 0.01
    assert np.all((blade[:, 1] * np.gradient(series.columns["r"], T))[turning] > 0.0)


def test_a_propeller_pushes_ahead_at_the_stern() -> None:
    ((_, shaft),) = parts_of([steered(0.4)], VESSEL, 10.0)
    np.testing.assert_allclose(shaft.end - shaft.start, np.tile([0.5 * 8.0, 0.0], (len(T), 1)))


def test_thrusters_push_where_they_are_and_where_they_point() -> None:
    columns = {"t": T, "pwm_1": np.ones_like(T), "alpha_1": np.full_like(T, 0.5 * np.pi)}
    series = Series("recording", columns, dict.fromkeys(columns, ""))
    inputs = {"pwm_1": {"low": -1.0, "high": 1.0}, "alpha_1": {"low": -3.2, "high": 3.2}}
    device = {"drive": "pwm_1", "alpha": "alpha_1", "x_m": 1.8, "y_m": -0.8}
    vessel = {"length_m": 5.0, "inputs": inputs, "devices": {"azimuth": device}}
    for hull in (5.0, 50.0):  # also of a hull that is drawn ten times as long
        ((thrust,),) = parts_of([series], vessel, hull)
        np.testing.assert_allclose(thrust.start[0], [1.8 * hull / 5.0, -0.8 * hull / 5.0])
        np.testing.assert_allclose((thrust.end - thrust.start)[0], [0.0, 0.8 * hull], atol=1e-9)


def test_forces_point_as_they_act_and_share_a_scale(voyages: Results) -> None:
    """Run 1: the force in sway is 500 N with the nominal model and 100 N with the identified."""
    scene = scene_of(voyages, 1, 50)
    nominal, identified = scene.sails
    assert [nominal.name, identified.name] == ["nominal model", "identified model"]
    sides = [(sail.parts[0].end - sail.parts[0].start)[:, 1] for sail in scene.sails]
    np.testing.assert_allclose(sides[0], 5.0 * sides[1])
    ahead = (nominal.parts[0].end - nominal.parts[0].start)[:, 0]
    np.testing.assert_allclose(ahead / sides[0], 50.0 * np.cos(nominal.psi) / 500.0, atol=1e-9)


def test_a_part_turns_with_the_hull(voyages: Results) -> None:
    (part,) = scene_of(voyages, 1, 50).sails[0].parts
    body = part.end[7] - part.start[7]
    north_up = part.in_plane(0.0, 0.0, 0.0, 7)
    np.testing.assert_allclose(north_up[1] - north_up[0], body[::-1])  # east is starboard
    eastward = part.in_plane(0.0, 0.0, 0.5 * np.pi, 7)
    np.testing.assert_allclose(eastward[1] - eastward[0], [body[0], -body[1]], atol=1e-9)


@pytest.fixture
def voyages(sailed: Path) -> Any:
    with open_results(f"sqlite:///{sailed}/results.db") as opened:
        yield opened


def test_a_page_holds_everything_and_a_film_is_as_long(
    program: Program, ship: Path, tmp_path: Path
) -> None:
    code, out, err = program("animate", "1", *database(ship), "--to", tmp_path / "a.html")
    assert (code, err) == (0, "")
    text = Path(out.strip()).read_text(encoding="utf-8")
    links = re.findall(r'(?:src|href)\s*=\s*["\']?([^"\'> ]+)', text)
    assert all(link.startswith(("#", "data:")) for link in links)
    assert "default-src 'none'" in text
    (scene,) = re.findall(r'<script type="application/json" id="scene">(.*?)</script>', text)
    parsed = json.loads(scene)
    assert parsed["length"] == 10.0
    assert len(parsed["sails"]) == 1
    assert parsed["sails"][0]["t"][-1] == pytest.approx(T[-1], abs=0.01)
    assert [part["kind"] for part in parsed["sails"][0]["parts"]] == ["rudder", "thrust"]


@pytest.fixture
def few_frames(monkeypatch: pytest.MonkeyPatch) -> int:
    """Films of so few frames that they are drawn quickly."""
    for form in (".gif", ".mp4"):
        monkeypatch.setitem(animation.FRAMES, form, 12)
    return 12


def test_a_gif_moves(program: Program, ship: Path, tmp_path: Path, few_frames: int) -> None:
    code, out, err = program("animate", "1", *database(ship), "--to", tmp_path / "a.gif")
    assert (code, err) == (0, "")
    with Image.open(out.strip()) as film:
        assert film.n_frames == few_frames  # type: ignore[attr-defined]
        pictures = []
        for frame in (0, few_frames // 2, few_frames - 1):
            film.seek(frame)
            pictures.append(film.convert("RGB").tobytes())
    assert len(set(pictures)) == 3


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="the program ffmpeg is not installed")
def test_an_mp4_moves(program: Program, ship: Path, tmp_path: Path, few_frames: int) -> None:
    """Decoded again: every frame, of an even size, and the ship elsewhere on each."""
    film = tmp_path / "a.mp4"
    code, _, err = program("animate", "1", *database(ship), "--to", film)
    assert (code, err) == (0, "")
    frames = tmp_path / "frames"
    frames.mkdir()
    words = ["ffmpeg", "-loglevel", "error", "-i", film, frames / "%03d.png"]
    subprocess.run(words, check=True)
    pictures = [Image.open(frame).convert("RGB") for frame in sorted(frames.iterdir())]
    assert len(pictures) == few_frames
    assert all(size % 2 == 0 for picture in pictures for size in picture.size)
    assert len({picture.tobytes() for picture in pictures}) == few_frames


def test_a_film_without_ffmpeg_is_refused_in_one_line(
    program: Program, ship: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "which", lambda _: None)
    code, _, err = program("animate", "1", *database(ship), "--to", tmp_path / "a.mp4")
    assert (code, len(err.splitlines())) == (2, 1)
    assert "needs the program ffmpeg" in err
    assert not (tmp_path / "a.mp4").exists()


@pytest.mark.parametrize("name", ["a.png", "a", "a.html.txt"])
def test_another_format_is_refused(program: Program, ship: Path, tmp_path: Path, name: str) -> None:
    code, _, err = program("animate", "1", *database(ship), "--to", tmp_path / name)
    assert (code, len(err.splitlines())) == (2, 1)
    assert "expected the ending .html, .gif or .mp4" in err


def test_a_run_that_does_not_move_in_the_plane_is_refused(
    voyages: Results, program: Program, sailed: Path, tmp_path: Path
) -> None:
    with pytest.raises(ConfigurationError, match="run 5 has no series"):
        scene_of(voyages, 5, 50)
    code, _, err = program("animate", "999", *database(sailed), "--to", tmp_path / "a.html")
    assert (code, len(err.splitlines())) == (2, 1)
    assert "999" in err
    columns = {"t": T, "x": T, "psi": 0.0 * T, "u": 0.0 * T + 1.0}
    units = {"t": "s", "x": "m", "psi": "rad", "u": "m/s"}
    with stored.logbook_at(tmp_path) as logbook:
        stored.finish(logbook, stored.start("none"), series=[Series("recording", columns, units)])
    code, _, err = program("animate", "1", *database(tmp_path), "--to", tmp_path / "a.html")
    assert (code, len(err.splitlines())) == (2, 1)
    assert "animate: run 1 has no y" in err


@pytest.mark.slow
@pytest.mark.parametrize(("width", "mobile"), [(390, True), (1280, False)])
def test_the_page_plays_in_a_browser(
    browser: Any, program: Program, ship: Path, tmp_path: Path, width: int, mobile: bool
) -> None:
    """The hull is where the track is at that time, within a sample at 3 m/s, and to scale."""
    _, out, _ = program("animate", "1", *database(ship), "--to", tmp_path / "a.html")
    open_page(browser, Path(out.strip()), width, mobile)
    assert complaints(browser) == []
    assert browser.execute_script("return document.documentElement.scrollWidth") <= width
    move = "const s = document.getElementById('time'); s.value = arguments[0];"
    browser.execute_script(move + "s.dispatchEvent(new Event('input'))", 500)
    points = browser.execute_script(
        "return document.querySelector('.far .hull').getAttribute('points')"
    )
    corners = np.array([[float(v) for v in pair.split(",")] for pair in points.split()])
    bow, stern = corners[0], 0.5 * (corners[2] + corners[3])
    assert np.hypot(*(bow - stern)) == pytest.approx(10.0, abs=0.01)
    columns = steered(0.4).columns
    k = int(np.searchsorted(T, 0.5 * T[-1]))
    np.testing.assert_allclose(0.5 * (bow + stern), [columns["y"][k], -columns["x"][k]], atol=0.31)
    browser.find_element("id", "play").click()
    assert browser.find_element("id", "play").text == "Pause"
