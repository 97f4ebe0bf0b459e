"""A mix along a plan: the counts are exact, and the vessel keeps to the path that was planned."""

from collections import Counter
from functools import cache
from typing import Any

import numpy as np
import pytest
import shapely

from seatrial.models.errors import ConfigurationError
from seatrial.models.simulation.loop import sail
from seatrial.models.simulation.voyage import Voyage
from seatrial.models.vessel.table import Vessel
from seatrial.models.weather.weather import Weather
from seatrial.runner.trial import check
from tests.trials import composed

PERIOD_S = 0.1
# The reference of a passage moves at 0.5 m/s at once. 3 N, less the drag of 1.25 N at that speed,
# bring 26 kg to it in v^2 / (2 a) at most.
RUN_UP = 0.5**2 / (2.0 * (3.0 - 1.25) / 26.0)
BASIN = (
    "vessel=modulus_ship", "excitation=mix", "controller=none", "excitation.length_s=60",
    "excitation.route.area=[[0,0],[60,0],[60,40],[0,40]]",
    "excitation.route.obstacles=[[[15,10],[30,10],[30,20],[15,20]],"
    "[[40,25],[45,22],[48,30],[41,33]]]",
    "excitation.route.start=[5,5,0]", "excitation.route.goal=[55,35,90]",
)  # fmt: skip


@cache
def trial(*overrides: str) -> Any:
    return composed(*BASIN, *overrides)


def voyage(asked: Any, model: Vessel) -> Voyage:
    """The plan, sailed by a vessel in calm water."""
    mix, n = asked.excitation, len(asked.excitation.schedule)
    still, t = np.zeros((n, 3)), PERIOD_S * np.arange(n)
    rng = np.random.default_rng(0)
    return sail(
        asked.vessel.plant(model), Weather(still, still, still, still),
        mix.guidance(t, mix.start), mix.reference_filter.table(PERIOD_S),
        mix.steering(asked.vessel.dofs, PERIOD_S), mix.start, PERIOD_S, 0.1,
        added=mix.force(t, asked.vessel.dofs, rng),
    )  # fmt: skip


def test_the_plan_has_the_counts_of_the_mix_and_touches_nothing() -> None:
    mix = trial().excitation
    sailed = Counter(leg.name for leg in mix.plan.legs if leg.informative)
    assert sailed == Counter({k: n for k, n in mix.counts.items() if n}) + Counter(mix.held_out)
    assert sum(mix.counts.values()) == 6
    track = shapely.LineString(mix.plan.poses[:, :2]).segmentize(0.02)
    points = shapely.points(shapely.get_coordinates(track))
    for one in mix.route.obstacles:
        assert np.min(shapely.distance(shapely.Polygon(one), points)) >= 1.0
    assert np.all(shapely.covers(shapely.Polygon(mix.route.area).buffer(-1.0), points))
    np.testing.assert_allclose(mix.plan.poses[0], [5.0, 5.0, 0.0])
    np.testing.assert_allclose(mix.plan.poses[-1, :2], [55.0, 35.0])
    assert np.cos(mix.plan.poses[-1, 2] - np.radians(90.0)) == pytest.approx(1.0)


def test_the_believed_vessel_sails_its_plan() -> None:
    asked = trial()
    log = voyage(asked, asked.vessel.nominal()).log
    planned = asked.excitation.plan.poses[: len(log.eta)]
    gap = np.hypot(*(log.eta - planned)[:, :2].T)
    assert np.max(gap) < RUN_UP
    assert np.median(gap) < 0.02
    assert gap[-1] < 0.1


def test_another_vessel_keeps_to_the_plan_by_feedback() -> None:
    """The true ship is 15 % lighter; without feedback it strays by metres."""
    found = {}
    for follow in ("everywhere", "passages"):
        asked = trial(f"excitation.route.follow={follow}")
        log = voyage(asked, asked.plant_scale * asked.vessel.nominal()).log
        planned = asked.excitation.plan.poses[: len(log.eta)]
        found[follow] = np.max(np.hypot(*(log.eta - planned)[:, :2].T))
    assert found["everywhere"] < RUN_UP
    assert found["passages"] > 4.0


def test_what_is_held_out_tests() -> None:
    mix = trial().excitation
    t = PERIOD_S * np.arange(len(mix.schedule))
    split = mix.split(t)
    assert np.sum(split.train) == 6 * 600
    assert np.sum(split.test) == 3 * 600
    testing = [part.name for part in mix.schedule.parts if part.role == "testing"]
    assert sorted(testing) == sorted(mix.held_out)


def test_the_start_is_also_the_goal_where_none_is_given() -> None:
    mix = trial("excitation.route.goal=null", "excitation.sub_experiments=4").excitation
    np.testing.assert_allclose(mix.plan.poses[-1, :2], mix.plan.poses[0, :2])


def test_a_lattice_follows_the_starting_heading() -> None:
    mix = trial("excitation.route.start=[6,6,33]", "excitation.held_out=[circle]").excitation
    assert mix.plan.start[2] == pytest.approx(np.radians(33.0))
    assert mix.start == pytest.approx(mix.plan.start)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("excitation.route.start=[20,15,0]",
         "excitation.route: start at (20, 15) m: it lies inside obstacles[0]"),
        ("excitation.route.goal=[99,15,0]",
         "excitation.route: goal at (99, 15) m: it lies outside area"),
        ("excitation.route.area=[[0,0],[60,0],[60,10],[0,10]] excitation.route.goal=null "
         "excitation.route.clearance_m=4.5 excitation.route.obstacles=[]",
         "fits nowhere in the area beside the obstacles"),
        ("excitation.route.area=null", "obstacles: got some without an area"),
        ("excitation.route.area=[[0,0],[1,1]]", "area: expected at least three corners"),
        ("excitation.route.cell_m=0", "cell_m must be positive or null, got 0"),
        ("excitation.route.speed_m_s=0", "speed_m_s must be positive, got 0"),
        ("excitation.route.follow=never", "expected one of everywhere, passages"),
    ],
)  # fmt: skip
def test_an_impossible_route_is_refused_in_one_line(override: str, message: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        check(composed(*BASIN, *override.split()))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
