"""The table of bands: what is counted, and how it is kept."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from docs.bands import Count, Row, Scored, left_out_in_turn, read, scored, shown, write
from seatrial.models.identification.model_error import ModelError
from seatrial.models.identification.problem import NoIdentifier
from seatrial.models.identification.validation import prediction
from tests.trials import excited

SURGE = ("vessel=surge_linear", "excitation=multisine", "controller=none", "evaluation=none")


def test_every_file_is_left_out_once(tmp_path: Path) -> None:
    for name in "abc":
        (tmp_path / f"{name}.dat").touch()
    train = json.dumps([str(tmp_path / "b.dat")])
    found = dict(left_out_in_turn((f"excitation.train={train}", "seed=0", "excitation.test=[]")))
    assert sorted(found) == ["a", "b", "c"]
    for name, options in found.items():
        given = {key: value for key, _, value in (each.partition("=") for each in options)}
        files = [Path(each).stem for each in json.loads(given["excitation.train"])]
        assert sorted([*files, name]) == ["a", "b", "c"]
        assert [Path(each).stem for each in json.loads(given["excitation.test"])] == [name]
        assert given["seed"] == "0"


@pytest.mark.parametrize("deviation", [0.5, 1.0])
def test_white_errors_of_known_size_are_counted(deviation: float) -> None:
    """A band of noise alone, of the right size and of half of it, with its width and CRPS."""
    own, _ = excited(*SURGE, "disturbance=calm")
    run = prediction(own.nominal, own.validation, None)
    spread, rng = run.mean_motion(), np.random.default_rng(0)
    white = 0.1 * spread * rng.standard_normal((len(own.validation), 2))
    white[0] = 0.0  # the run begins at the true state
    motion = run.motion() + white
    noisy = replace(own.validation, eta=motion[:, :1], nu=motion[:, 1:])
    error = ModelError(1.0, 0.0, 1.0, np.zeros(1), deviation * 0.1 * spread)
    result = NoIdentifier().identify(own, rng)
    problem = replace(own, validation=noisy)
    done = scored(replace(result, model_error=error), problem, None)
    assert done is not None
    inside = 0.90 if deviation == 1.0 else 0.589
    n = len(noisy) - 1
    assert done.velocity.states == n
    assert done.velocity.inside / n == pytest.approx(inside, abs=0.02)
    moved = np.std(noisy.nu) / spread[1]
    assert done.velocity.width / n == pytest.approx(3.29 * deviation * 0.1 / moved, rel=0.1)
    assert done.measures == (0, 0)


def test_rows_are_kept_and_replaced_by_case(tmp_path: Path) -> None:
    part = Scored(Count(10, 9.0, 20.0, 1.0), Count(10, 5.0, 40.0, 4.0), (3, 4))
    row = Row("ferry", "noise 0", "auto", part, part, 1.5)
    file = tmp_path / "bands.json"
    write([row, replace(row, case="noise 1", both=None, note="it diverges")], file)
    write([replace(row, seconds=2.5)], file)
    kept = read(file)
    assert [(each.case, each.seconds) for each in kept] == [("noise 0", 2.5), ("noise 1", 1.5)]
    assert kept[0].both == part
    line = shown(kept).splitlines()[-1]
    assert "0.90, 2.00, 0.100" in line
    assert "3 of 4" in line
    assert "1 of 2" in line  # cases
