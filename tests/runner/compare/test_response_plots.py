"""`plot response`: what stands over what, of one run and of runs of several controllers."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.frame import Queries
from seatrial.runner.database import LogbookWriter
from seatrial.runner.record.rows import Series
from tests.runner.compare import stored
from tests.runner.compare.drawing import axes_of, line

T = np.arange(0.0, 60.0, 0.5)
SIZES = {"surge": ("x", 10.0), "sway": ("y", 10.0), "yaw": ("psi", np.radians(20.0))}


def voyage(model: str, lag_s: float, *, wind: bool = True, reference: float = 1.0) -> Series:
    """A step of 10 m and 20 deg at 20 s, reached at once, so many seconds late."""
    step, late = (1.0 * (at <= T) for at in (20.0, 20.0 + lag_s))
    columns = {"t": T}
    for dof, (name, size) in SIZES.items():
        poses = {name: late, f"{name}_d": reference * step, f"{name}_setpoint": step}
        columns |= {key: size * values for key, values in poses.items()}
        columns |= {f"tau_{dof}": 100.0 * lag_s * (step - late)}
        columns |= {f"wind_{dof}": 7.0 + 0.0 * T} if wind else {}
    return stored.series(f"deployment_{model}", columns)


def sail(
    logbook: LogbookWriter, controller: str, lag_s: float, seed: int, preview: str = "none",
    **kind: Any,
) -> None:  # fmt: skip
    config = {"controller": {"_target_": controller, "preview": preview}}
    begin = stored.start("none", "wind", seed, config=config, controller=controller)
    sailed = [voyage(model, lag_s, **kind) for model in ("nominal", "identified")]
    stored.finish(logbook, begin, series=sailed)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Runs 1 to 3: lqi, mpc, mpc with preview, seed 0; 4: lqi, seed 1; 5: no wind, seed 2."""
    folder = tmp_path_factory.mktemp("controlled")
    with stored.logbook_at(folder) as logbook:
        sail(logbook, "lqi", 4.0, 0)
        sail(logbook, "mpc_integral", 3.0, 0)
        sail(logbook, "mpc_integral", 1.0, 0, "setpoint")
        sail(logbook, "lqi", 5.0, 1)
        sail(logbook, "pid_ff", 2.0, 2, wind=False, reference=0.9)
    return folder


def labels(axes: Axes) -> list[str]:
    return [str(one.get_label()) for one in axes.lines]


def reached(axes: Axes, label: str, value: float) -> float:
    """When a line is above a value for the first time."""
    t, values = line(axes, label).T
    return float(t[np.argmax(values > value)])


def test_response_has_three_panels_an_axis(results: Queries) -> None:
    axes = axes_of("response", results, run=1)
    assert [one.get_ylabel() for one in axes] == [
        "North [m]", "East [m]", "Heading [deg]",
        "Force, surge [N]", "Force, sway [N]", "Force, yaw [Nm]",
        "Wind, surge [N]", "Wind, sway [N]", "Wind, yaw [Nm]",
    ]  # fmt: skip
    assert [one.get_xlabel() for one in axes[6:]] == ["Time [s]"] * 3
    heading = axes[2]
    assert line(heading, "set-point")[:, 1].max() == pytest.approx(20.0)  # degrees
    assert reached(heading, "nominal model", 10.0) == 24.0
    assert line(axes[3], "nominal model")[:, 1].max() == 400.0
    assert set(line(axes[6], "wind")[:, 1]) == {7.0}


def test_without_wind_there_are_two_panels_and_a_reference_of_its_own_is_shown(
    results: Queries,
) -> None:
    axes = axes_of("response", results)  # the newest
    assert len(axes) == 6
    assert line(axes[0], "reference")[:, 1].max() == pytest.approx(9.0)
    assert line(axes[0], "set-point")[:, 1].max() == pytest.approx(10.0)


def test_one_axis_alone(results: Queries) -> None:
    assert len(axes_of("response", results, run=1, dof=["yaw"])) == 3
    with pytest.raises(ConfigurationError, match="run 1 has no response of these degrees"):
        axes_of("response", results, run=1, dof=["heave"])


def test_controllers_lie_over_one_another_where_all_else_is_equal(results: Queries) -> None:
    """Seed 0: its newest run of each level, and never one of another seed."""
    axes = axes_of("response", results, rows="controller", where="seed=0")
    assert labels(axes[0]) == ["set-point", "lqi", "mpc_integral"]
    late = {name: reached(axes[0], name, 5.0) for name in ("lqi", "mpc_integral")}
    assert late == {"lqi": 24.0, "mpc_integral": 21.0}  # the newest of mpc_integral: run 3
    assert labels(axes[6]) == ["wind"]


def test_rows_are_any_factors(results: Queries) -> None:
    rows = "controller, controller.preview"
    axes = axes_of("response", results, rows=rows, where="seed=0")
    expected = ["set-point", "lqi, none", "mpc_integral, none", "mpc_integral, setpoint"]
    assert labels(axes[0]) == expected
    axes = axes_of("response", results, rows="controller.preview", where="seed=0")
    assert labels(axes[0]) == ["set-point", "none", "setpoint"]  # of mpc_integral alone


def test_one_controller_is_nothing_to_compare(results: Queries) -> None:
    with pytest.raises(ConfigurationError, match="no two finished runs that differ in controller"):
        axes_of("response", results, rows="controller", where="seed=1")
    with pytest.raises(ConfigurationError, match="sailed with the adaptive model"):
        axes_of("response", results, rows="controller", model="adaptive")
    with pytest.raises(ConfigurationError, match="'controler' is not known"):
        axes_of("response", results, rows="controler")
