"""`seatrial next`: what cannot be done is one line, and its YAML sails what its sheet says."""

import csv
import re
from pathlib import Path

import numpy as np
import pytest

from tests.runner.command import Command

SQUARE = '{"type": "Polygon", "coordinates": [[[0,0],[%s,0],[%s,%s],[0,%s],[0,0]]]}'
OTTER = ("next", "--vessel", "otter", "--database", "sqlite:///none.db")


def _area(folder: Path, side: float) -> Path:
    path = folder / "area.geojson"
    path.write_text(SQUARE.replace("%s", f"{side:g}"))
    return path


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--for", "advance"), "next: --for advance: expected PURPOSE=WIDTH"),
        (("--for", "advance=0%"), "next: --for advance=0%: expected PURPOSE=WIDTH"),
        (("--for", "FIT=2", "--start", "1,2"), "next: --start 1,2: expected 3 numbers"),
        (("--for", "FIT=2", "--after", "1"), "next: expected --after RUNS or --vessel NAME"),
        (("--for", "FIT=2", "--area", "none.geojson"), "none.geojson: cannot be read"),
        (("--for", "FIT=2", "--doubt", "2"), "next: --doubt 2: expected a number between 0 and 1"),
    ],
)
def test_words_that_are_wrong_are_one_line(
    seatrial: Command, words: tuple[str, ...], said: str
) -> None:
    assert seatrial.refuses(*OTTER, *words).startswith(said)


@pytest.mark.slow
def test_what_cannot_be_sailed_or_predicted_is_one_line(
    seatrial: Command, tmp_path_factory: pytest.TempPathFactory
) -> None:
    said = seatrial.refuses(*OTTER, "--for", "head_reach=3%")
    assert said.startswith("next: otter has no measure head_reach, expected coefficients, FIT")
    assert "tactical_diameter" in said
    area = str(_area(tmp_path_factory.mktemp("area"), 6.0))
    said = seatrial.refuses(*OTTER, "--for", "FIT=2", "--area", area, "--start", "3,3,0")
    assert said.startswith("next: area: no turning circle fits")
    said = seatrial.refuses(*OTTER, "--for", "FIT=2", "--minutes", "0.1")
    assert re.match(r"next: none of \d+ manoeuvres fits into 0.1 min", said)


@pytest.mark.slow
def test_the_sheet_stays_in_its_area_and_time_and_its_yaml_sails_it(seatrial: Command) -> None:
    side = 60.0
    words = (
        "--area",
        str(_area(Path(), side)),
        "--start",
        "30,30,90",
        "--minutes",
        "3",
        "--clearance",
        "2",
    )
    answer = seatrial(*OTTER, "--for", "coefficients=1%", *words)
    assert answer.code == 0, answer
    assert "1 % is not reached in 3 min: the best that was found is" in answer.out
    widths = [float(n) for n in re.findall(r"± ([\d.]+) %", answer.out)]
    assert widths == sorted(widths, reverse=True)
    folder = Path("results/next")
    rows = list(csv.DictReader((folder / "track.csv").read_text().splitlines()))
    track = np.array([[float(row[name]) for name in ("north", "east")] for row in rows])
    assert np.all((track >= 2.0) & (track <= side - 2.0))
    assert float(rows[-1]["t"]) <= 180.0
    assert np.hypot(*(track[-1] - track[0])) < 10.0
    sailed = seatrial(
        "vessel=otter", f"excitation={folder}/excitation.yaml", "identifier=none",
        "controller=none", "evaluation=none",
    )  # fmt: skip
    assert sailed.code == 0, sailed


@pytest.mark.nightly
def test_what_came_is_of_the_size_that_was_expected(seatrial: Command) -> None:
    answer = seatrial("next", "--vessel", "kvlcc2", "--for", "tactical_diameter=2%")
    assert answer.code == 0, answer
    sailed = seatrial(
        "vessel=kvlcc2", "excitation=results/next/excitation.yaml", "disturbance=noise",
        "identifier=robust", "model_error=false", "controller=none", "evaluation=none",
    )  # fmt: skip
    assert sailed.code == 0, sailed
    after = seatrial("next", "--after", "1", "--for", "tactical_diameter=9%")
    found = re.search(r"expected ± ([\d.]+) %, came ± ([\d.]+) %", after.out)
    assert found is not None, after
    assert 0.2 < float(found[2]) / float(found[1]) < 5.0
