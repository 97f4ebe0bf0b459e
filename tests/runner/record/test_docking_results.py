"""Results of a docking: from a voyage that follows its set-points exactly, and one that misses."""

from dataclasses import replace

import numpy as np
import pytest
import shapely

from seatrial.models.excitation.docking import Docking
from seatrial.models.planning.harbour import Harbour
from seatrial.models.simulation.voyage import Log, Voyage
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import in_ned
from seatrial.models.weather.weather import Weather
from seatrial.runner.record.catalogue import METRICS
from seatrial.runner.trials.berthing import berthing_results
from seatrial.runner.trials.closed_loop import ControlDesign, SimulatedMission, Streams, drawn
from tests.trials import composed

PLANE = ("surge", "sway", "yaw")


def mission(vessel: str = "milliampere") -> Docking:
    trial = composed(f"vessel={vessel}", "evaluation=docking", "identifier=none", "seed=1")
    evaluation = drawn(trial, Streams(1)).evaluation
    assert isinstance(evaluation, Docking)
    return evaluation


def place(docking: Docking) -> Harbour:
    return next(iter(docking.harbours.values()))


def sailed(docking: Docking, poses: Array, tau: Array | None = None) -> SimulatedMission:
    """A voyage through these poses, with limits of 1 on each axis."""
    zero = np.zeros((len(poses), 3))
    log = Log(*(zero for _ in Log._fields))._replace(eta=poses, tau=zero if tau is None else tau)
    weather = Weather(zero, zero, zero, zero)
    period = docking.period_s
    voyage = Voyage(period * np.arange(len(poses)), log, PLANE, weather)
    return SimulatedMission(voyage, period, ControlDesign(PLANE, np.zeros(3), (1.0, 1.0, 1.0)))


def values(docking: Docking, voyage: SimulatedMission) -> dict[str, float]:
    rows = berthing_results(docking, voyage, "nominal").metrics
    return {row.name: row.value for row in rows if row.value is not None}


def test_an_exact_voyage_is_berthed_with_the_gap() -> None:
    docking = mission()
    poses, found = docking.poses, values(docking, sailed(docking, docking.poses))
    assert found["contacts"] == 0.0
    assert found["smallest_clearance"] == pytest.approx(docking.gap, rel=1e-6)
    assert found["final_position_error"] == found["final_heading_error"] == 0.0
    length = docking.vessel.scales.length_m
    off = np.hypot(*(poses - poses[-1])[:, :2].T) / length
    first = int(np.flatnonzero(off > docking.within)[-1]) + 1
    assert found["time_to_berth"] == pytest.approx(first * docking.period_s)


def test_a_run_shows_contacts_and_the_error_in_the_berth_first() -> None:
    docking = mission()
    shown = {(metric.name, metric.headline) for metric in METRICS}
    rows = berthing_results(docking, sailed(docking, docking.poses), "nominal").metrics
    assert {row.name for row in rows if (row.name, row.dof) in shown} == {
        "contacts", "final_position_error"
    }  # fmt: skip


def test_a_voyage_into_the_quay_and_one_beside_the_berth() -> None:
    docking = mission()
    poses, length = docking.poses, docking.vessel.scales.length_m
    towards = -0.1 * length * place(docking).away
    into = values(docking, sailed(docking, poses + towards))
    assert into["contacts"] == 1.0
    assert into["smallest_clearance"] == 0.0
    assert into["final_position_error"] == pytest.approx(0.1)
    assert np.isnan(into["time_to_berth"])
    turned = values(docking, sailed(docking, poses + np.array([0.0, 0.0, np.radians(-2.0)])))
    assert turned["final_heading_error"] == pytest.approx(2.0)
    assert turned["contacts"] == 0.0


def test_saturation_counts_a_sample_once() -> None:
    docking = mission()
    tau = np.zeros((len(docking.poses), 3))
    tau[:10, 0], tau[5:20, 2] = 1.0, -1.0
    found = values(docking, sailed(docking, docking.poses, tau))
    assert found["saturated_share"] == pytest.approx(20.0 / len(tau))


def test_the_metrics_do_not_depend_on_the_frame() -> None:
    """Of a harbour and a voyage, off the set-points, that are moved and turned together."""
    docking = mission()
    poses = docking.poses + np.random.default_rng(0).normal(0.0, 0.02, docking.poses.shape)
    turn, away = 1.1, np.array([300.0, -70.0])

    def moved(points: Array) -> Array:
        return np.asarray(in_ned(points, turn) + away)

    def moved_poses(at: Array) -> Array:
        return np.column_stack([moved(at[:, :2]), at[:, 2] + turn])

    [(name, harbour)] = docking.harbours.items()
    land = shapely.transform(harbour.land, moved)
    there = moved_poses(docking.poses)
    other = replace(docking, poses=there)
    other.harbours[name] = harbour._replace(land=land)
    first = values(docking, sailed(docking, poses))
    second = values(other, sailed(other, moved_poses(poses)))
    for name, value in first.items():
        assert second[name] == pytest.approx(value, abs=1e-6, nan_ok=True), name


def test_the_stored_harbour_has_the_hull_and_the_land() -> None:
    docking = mission()
    columns = berthing_results(docking, sailed(docking, docking.poses), "nominal").series[0].columns
    corners = np.column_stack([columns["x"], columns["y"]])
    hull = corners[columns["polygon"] == 0.0]
    np.testing.assert_allclose(np.ptp(hull, axis=0), [5.0, 5.0 / 3.0])
    parts = [
        shapely.Polygon(corners[columns["polygon"] == number])
        for number in np.unique(columns["polygon"])[1:]
    ]
    assert shapely.union_all(parts).area == pytest.approx(place(docking).land.area)
