"""Measured wind: from where it blows, over ground or as on board, to the velocity of the air."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from seatrial.models.recording.recording import Recording
from tests.models.recording.test_file_set import reader
from tests.models.recording.test_froude import DOFS, mapped
from tests.models.recording.test_froude import MAP as SHIP

MAP = {**SHIP, "inputs": {"n": "n"}, "loads": {}}
TRUE = {
    "speed": {"column": "speed", "unit": "knot"},
    "direction": {"column": "from", "unit": "deg"},
}
SPEED_KN, HEADING_DEG = 10.0, 90.0
KNOT = 1852.0 / 3600.0


def recorded(path: Path, wind: Mapping[str, object], direction: NDArray[np.float64]) -> Recording:
    """A ship that moves east at 2 m/s, drifting to the south at 0.5 m/s."""
    t = 0.1 * np.arange(40)
    columns = {
        "t": t, "x": -0.5 * t, "y": 2.0 * t, "psi": HEADING_DEG + 0.0 * t, "u": 2.0 + 0.0 * t,
        "v": 0.5 + 0.0 * t, "r": 0.0 * t, "n": 10.0 + 0.0 * t, "speed": SPEED_KN + 0.0 * t,
        "from": direction,
    }  # fmt: skip
    rows = np.column_stack(list(columns.values()))
    np.savetxt(path, rows, delimiter=",", header=",".join(columns), comments="")
    content = mapped(path.with_suffix(".yaml"), {**MAP, "wind": wind})
    return reader(path=str(path), map=str(content)).read(DOFS)


@pytest.mark.parametrize(
    ("from_deg", "expected"),
    [(90.0, (-1.0, 0.0)), (180.0, (0.0, -1.0)), (270.0, (1.0, 0.0)), (0.0, (0.0, 1.0))],
)
def test_a_true_wind_comes_from_its_direction(
    tmp_path: Path, from_deg: float, expected: tuple[float, float]
) -> None:
    """The ship heads east: an easterly is ahead, a southerly from starboard, to port."""
    recording = recorded(tmp_path / "a.csv", TRUE, np.full(40, from_deg))
    np.testing.assert_allclose(
        recording.wind, np.tile(SPEED_KN * KNOT * np.array(expected), (40, 1)), atol=1e-12
    )


def test_what_is_felt_on_board_is_the_wind_minus_the_motion(tmp_path: Path) -> None:
    """nu_q = nu - nu_w: the apparent wind from the bow has u_q = V, v_q = 0."""
    apparent = {**TRUE, "kind": "apparent"}
    recording = recorded(tmp_path / "a.csv", apparent, np.zeros(40))
    through_air = recording.nu[:, :2] - recording.wind
    np.testing.assert_allclose(through_air[:, 0], SPEED_KN * KNOT)
    np.testing.assert_allclose(through_air[:, 1], 0.0, atol=1e-12)


def test_a_direction_is_resampled_across_north(tmp_path: Path) -> None:
    """Between 359 and 1 deg the wind is northerly, not southerly."""
    direction = np.where(np.arange(40) % 2, 1.0, 359.0)
    content = {**TRUE, "kind": "true"}
    recorded(tmp_path / "a.csv", content, direction)
    file, own = tmp_path / "a.csv", tmp_path / "a.yaml"
    recording = reader(path=str(file), map=str(own), resample_hz=20).read(DOFS)
    assert np.all(recording.wind[:, 1] > 0.99 * SPEED_KN * KNOT)
