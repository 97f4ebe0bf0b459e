"""The command `manoeuvres`: sheets of stored runs and of files, and their errors of one line."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from seatrial.runner.export.manoeuvre_tracks import ordered_in
from tests.data import DATA
from tests.runner.compare import stored
from tests.runner.compare.conftest import Program
from tests.runner.compare.test_command_line import database

MARIN = """
time: {column: c1, uniform: true}
position: {surge: c2, sway: c3}
heading: {column: c5, unit: deg}
velocity: {surge: c6, sway: c7}
inputs: {delta: {column: c10, unit: deg}}
"""
CIRCLE = """
time: c1
position: {surge: c2, sway: c3}
heading: c4
inputs: {delta: c5}
"""
LATE_S = 0.05  # from half of the step of the helm, between two samples, to the turn


def values(out: str) -> dict[str, dict[str, object]]:
    return {row["quantity"]: row for row in json.loads(out)}


@pytest.fixture
def mapped(tmp_path: Path) -> Callable[[str], Path]:
    """Writes a map."""

    def write(text: str) -> Path:
        (tmp_path / "map.yaml").write_text(text, encoding="utf-8")
        return tmp_path / "map.yaml"

    return write


@pytest.fixture
def circle(tmp_path: Path) -> Path:
    """A file of the circle, of numbers without a header."""
    columns = stored.circle().columns
    names = ("t", "x", "y", "psi", "delta")
    file = tmp_path / "circle.dat"
    np.savetxt(file, np.column_stack([columns[name] for name in names]), header="a circle")
    return file


def test_the_sheet_of_a_circle_is_its_geometry(program: Program, sailed: Path) -> None:
    """A circle of three ship lengths that begins at once: advance 3, transfer 3, diameters 6."""
    code, out, _ = program("manoeuvres", "9", *database(sailed), "--format", "json")
    assert code == 0
    rows = values(out)
    expected = {
        "advance": 3.0, "transfer": 3.0, "tactical diameter": 6.0, "steady diameter": 6.0,
        "speed loss": 0.0, "drift angle": 0.0, "yaw rate": np.degrees(2.0 / 30.0),
        "time to 90 deg": 7.5 * np.pi + LATE_S, "time to 180 deg": 15.0 * np.pi + LATE_S,
    }  # fmt: skip
    for name, value in expected.items():
        assert rows[name]["value"] == pytest.approx(value, abs=0.02), name
    assert rows["tactical diameter"]["metres"] == pytest.approx(60.0, abs=0.1)
    for name, limit, passed in (("advance", 4.5, "pass"), ("tactical diameter", 5.0, "fail")):
        assert (rows[name]["limit"], rows[name]["MSC.137(76)"]) == (limit, passed)


def test_a_file_has_the_sheet_of_the_run(
    program: Program, sailed: Path, circle: Path, mapped: Callable[[str], Path]
) -> None:
    """The speed follows from the path, where there are no velocities."""
    _, of_run, _ = program("manoeuvres", "9", *database(sailed), "--format", "json")
    columns = ("--map", mapped(CIRCLE))
    code, out, _ = program("manoeuvres", circle, "--length", "10", *columns, "--format", "json")
    assert code == 0
    for name, row in values(of_run).items():
        assert values(out)[name]["value"] == pytest.approx(row["value"], rel=1e-3, abs=0.1)


def test_what_the_map_says_was_ordered_decides_on_the_limits(
    program: Program, circle: Path, mapped: Callable[[str], Path]
) -> None:
    """The helm of the file is at full; what was ordered had no limits."""
    words = ("manoeuvres", circle, "--length", "10", "--format", "json", "--map")
    stated = "manoeuvre: {kind: turn, helm_deg: 20}\n"
    for text, limit in ((CIRCLE, 4.5), (CIRCLE + stated, None)):
        code, out, err = program(*words, mapped(text))
        assert code == 0, err
        assert values(out)["advance"]["limit"] == limit
    assert ordered_in({"manoeuvre": {"kind": "turn", "helm_deg": 20}}).helm_deg == 20  # as stored
    code, out, err = program(*words, mapped(f"{CIRCLE}manoeuvre: {{kind: loop}}\n"))
    assert (code, out) == (2, "")
    assert "excitation.manoeuvre.kind: got 'loop', expected one of turn, zigzag," in err


@pytest.mark.data
def test_a_measured_zigzag_of_a_full_ship(program: Program, mapped: Callable[[str], Path]) -> None:
    """MARIN's 10/10 of KVLCC2: 9.5 and 15.0 degrees are published, IMO allows 20 and 40."""
    file = DATA / "kvlcc2" / "marin" / "MARIN_FREE_KVLCC2_zz_10_m.dat"
    options = ("--length", "320", "--map", mapped(MARIN))
    code, out, err = program("manoeuvres", file, *options, "--format", "json")
    assert (code, err) == (0, "")
    rows = values(out)
    for name, published, allowed in (("first", 9.5, 20.0), ("second", 15.0, 40.0)):
        row = rows[f"{name} overshoot"]
        assert row["value"] == pytest.approx(published, abs=0.2)
        assert (row["limit"], row["MSC.137(76)"]) == (allowed, "pass")


@pytest.mark.parametrize(
    ("given", "wrong", "message"),
    [
        ("inputs: {delta: c5}", "", "got inputs none, expected the helm delta"),
        ("delta: c5", "rudder: c5", "got inputs rudder, expected the helm delta"),
        ("delta: c5", "delta: c6", "no column 'c6'"),
        ("c4", "{column: c4, unit: acre}", "acre"),
        ("time: c1", "time: c5", "column c5, line 3: got"),
    ],
)
def test_wrong_maps_are_one_line(
    program: Program, circle: Path, mapped: Callable[[str], Path], given: str, wrong: str,
    message: str,
) -> None:  # fmt: skip
    file = mapped(CIRCLE.replace(given, wrong))
    code, out, err = program("manoeuvres", circle, "--length", "10", "--map", file)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert message in err


def test_a_run_without_a_helm_and_a_file_without_a_length_are_one_line(
    program: Program, sailed: Path, circle: Path
) -> None:
    for arguments, message in (
        (("1", *database(sailed), "--length", "10"), "has no u, expected a steered vessel"),
        (("1", *database(sailed)), "its vessel has no length, expected --length"),
        ((circle, "--map", "map.yaml"), "expected --length"),
        ((circle, "--length", "10"), "expected --map"),
    ):
        code, out, err = program("manoeuvres", *arguments)
        assert (code, out, err.count("\n")) == (2, "", 1)
        assert message in err


def test_full_scale_is_said_of_a_model_with_a_scale(program: Program, sailed: Path) -> None:
    """L / V grows by the square root of the scale: 10 m at 2 m/s, 5 s, at 1:4 10 s."""
    for words, said in (((), "L/V 5.00 s"), (("--scale", "4"), "L/V at full scale 10.0 s")):
        assert said in program("manoeuvres", "9", *database(sailed), *words)[1]
