"""`plot response` and `plot controllers`: three panels an axis, and what may stand over what."""

from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.frame import Queries
from seatrial.runner.compare.plots import controllers, response
from seatrial.runner.compare.plots.request import PlotRequest
from seatrial.runner.compare.plots.style import drawn
from seatrial.runner.database import LogbookWriter
from seatrial.runner.record.rows import Series
from tests.runner.compare import stored

T = np.arange(0.0, 60.0, 0.5)
SIZES = {"surge": ("x", 10.0), "sway": ("y", 10.0), "yaw": ("psi", np.radians(20.0))}


def voyage(model: str, lag_s: float, *, wind: bool = True, reference: float = 1.0) -> Series:
    """A step of 10 m and 20 deg at 20 s, reached at once, so many seconds late."""
    step, late = (1.0 * (at <= T) for at in (20.0, 20.0 + lag_s))
    columns, units = {"t": T}, {"t": "s"}
    for dof, (name, size) in SIZES.items():
        poses = {name: late, f"{name}_d": reference * step, f"{name}_setpoint": step}
        columns |= {key: size * values for key, values in poses.items()}
        forces = {f"tau_{dof}": 100.0 * lag_s * (step - late)}
        forces |= {f"wind_{dof}": 7.0 + 0.0 * T} if wind else {}
        columns |= forces
        units |= dict.fromkeys(poses, "rad" if dof == "yaw" else "m")
        units |= dict.fromkeys(forces, "Nm" if dof == "yaw" else "N")
    return Series(f"deployment_{model}", columns, units)


def sail(
    logbook: LogbookWriter,
    controller: str,
    lag_s: float,
    seed: int,
    preview: str = "none",
    **kind: Any,
) -> None:
    config = {"controller": {"_target_": controller, "preview": preview}}
    begin = stored.start("none", "wind", seed, config=config)
    told = f"{controller} {preview} {seed}"
    fingerprint = sha256(told.encode()).hexdigest()
    sailed = [voyage(model, lag_s, **kind) for model in ("nominal", "identified")]
    begin = replace(begin, controller=controller, fingerprint=fingerprint)
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


def axes_of(module: Any, results: Queries, **options: Any) -> list[Axes]:
    with drawn():
        (made,) = module.drawings(results, PlotRequest(**options))
        made.figure.draw_without_rendering()
    return list(made.figure.axes)


def line(axes: Axes, label: str) -> np.ndarray[Any, Any]:
    return np.asarray(next(one for one in axes.lines if one.get_label() == label).get_ydata())


def labels(axes: Axes) -> list[str]:
    return [str(one.get_label()) for one in axes.lines]


def test_response_has_three_panels_an_axis(results: Queries) -> None:
    axes = axes_of(response, results, run=1)
    assert [one.get_ylabel() for one in axes] == [
        "North [m]", "East [m]", "Heading [deg]",
        "Force, surge [N]", "Force, sway [N]", "Force, yaw [Nm]",
        "Wind, surge [N]", "Wind, sway [N]", "Wind, yaw [Nm]",
    ]  # fmt: skip
    assert [one.get_xlabel() for one in axes[6:]] == ["Time [s]"] * 3
    heading = axes[2]
    assert line(heading, "set-point").max() == pytest.approx(20.0)  # degrees
    late = line(heading, "nominal model")
    assert T[np.argmax(late > 10.0)] == 24.0
    assert line(axes[3], "nominal model").max() == 400.0
    assert set(line(axes[6], "wind")) == {7.0}


def test_without_wind_there_are_two_panels_and_a_reference_of_its_own_is_shown(
    results: Queries,
) -> None:
    axes = axes_of(response, results)  # the newest
    assert len(axes) == 6
    assert line(axes[0], "reference").max() == pytest.approx(9.0)
    assert line(axes[0], "set-point").max() == pytest.approx(10.0)


def test_one_axis_alone(results: Queries) -> None:
    assert len(axes_of(response, results, run=1, dofs=("yaw",))) == 3
    with pytest.raises(ConfigurationError, match="run 1 has no response of these degrees"):
        axes_of(response, results, run=1, dofs=("heave",))


def test_controllers_lie_over_one_another_where_all_else_is_equal(results: Queries) -> None:
    """Seed 0: its newest run of each level, and never one of another seed."""
    axes = axes_of(controllers, results, rows="controller", where="seed=0")
    assert labels(axes[0]) == ["set-point", "lqi", "mpc_integral"]
    late = {name: T[np.argmax(line(axes[0], name) > 5.0)] for name in ("lqi", "mpc_integral")}
    assert late == {"lqi": 24.0, "mpc_integral": 21.0}  # the newest of mpc_integral: run 3
    assert labels(axes[6]) == ["wind"]


def test_rows_are_any_factors(results: Queries) -> None:
    rows = "controller, controller.preview"
    axes = axes_of(controllers, results, rows=rows, where="seed=0")
    expected = ["set-point", "lqi, none", "mpc_integral, none", "mpc_integral, setpoint"]
    assert labels(axes[0]) == expected
    axes = axes_of(controllers, results, rows="controller.preview", where="seed=0")
    assert labels(axes[0]) == ["set-point", "none", "setpoint"]  # of mpc_integral alone


def test_one_controller_is_nothing_to_compare(results: Queries) -> None:
    with pytest.raises(ConfigurationError, match="no two finished runs that differ in controller"):
        axes_of(controllers, results, rows="controller", where="seed=1")
    with pytest.raises(ConfigurationError, match="sailed with the adaptive model"):
        axes_of(controllers, results, rows="controller", model="adaptive")
    with pytest.raises(ConfigurationError, match="'controler' is not known"):
        axes_of(controllers, results, rows="controler")
