"""Columns are recognised by names as loggers write them, with the unit at the end."""

from pathlib import Path

import numpy as np
import pytest

from seatrial.models.recording.proposal import propose
from seatrial.models.recording.sources import ReadOptions, read_sources

KNOTS, TURN = {"unit": "knot"}, {"unit": "deg/min"}
FORCES = {"surge": "Fx_N", "sway": "Fy_N", "yaw": "Mz_Nm"}
HEADING = {"column": "hdg_deg", "unit": "deg"}


def proposed(folder: Path, names: str) -> dict[str, object]:
    """The map of a log whose columns have these names, the first of them the time."""
    columns = names.split()
    t = np.arange(0.0, 60.0, 0.2)
    values = np.column_stack([t, *(np.sin(t / (3.0 + k)) for k in range(1, len(columns)))])
    np.savetxt(folder / "log.csv", values, delimiter=",", header=",".join(columns), comments="")
    return propose(read_sources(folder / "log.csv", ReadOptions()))


@pytest.mark.parametrize(
    ("time", "unit"),
    [("stamp_s", None), ("t_s", None), ("elapsed_time_s", None), ("time_ms", "ms")],
)
def test_the_time_of_a_logger(tmp_path: Path, time: str, unit: str | None) -> None:
    result = proposed(tmp_path, f"{time} north_m east_m hdg_deg Fx_N Fy_N Mz_Nm")
    assert result == {
        "time": time if unit is None else {"column": time, "unit": unit},
        "position": {"surge": "north_m", "sway": "east_m", "yaw": HEADING},
        "force": FORCES,
    }


@pytest.mark.parametrize(
    ("names", "velocity"),
    [
        (
            "spd_fwd_kn spd_stbd_kn rot_deg_min",
            {"surge": {"column": "spd_fwd_kn", **KNOTS}, "sway": {"column": "spd_stbd_kn", **KNOTS},
             "yaw": {"column": "rot_deg_min", **TURN}},
        ),
        (
            "surge_speed_kts sway_speed_kts rate_of_turn_deg_per_min",
            {"surge": {"column": "surge_speed_kts", **KNOTS},
             "sway": {"column": "sway_speed_kts", **KNOTS},
             "yaw": {"column": "rate_of_turn_deg_per_min", **TURN}},
        ),
    ],
)  # fmt: skip
def test_velocities_in_knots_and_degrees(
    tmp_path: Path, names: str, velocity: dict[str, object]
) -> None:
    result = proposed(tmp_path, f"t north east hdg_deg {names} tau_x_kN tau_y_kN moment_z_kNm")
    assert result["velocity"] == velocity
    assert result["force"] == {
        "surge": {"column": "tau_x_kN", "unit": "kN"},
        "sway": {"column": "tau_y_kN", "unit": "kN"},
        "yaw": {"column": "moment_z_kNm", "unit": "kNm"},
    }
