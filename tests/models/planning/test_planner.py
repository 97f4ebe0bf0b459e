"""Plans: counts exact, nothing touched, no cheaper one, and a reason where there is none."""

from collections import Counter
from heapq import heappop, heappush

import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from seatrial.models.errors import ConfigurationError
from seatrial.models.planning.planner import (
    MOST_STATES,
    UNREACHED,
    Pace,
    PlannedPath,
    PlanningTask,
    Setting,
    Waters,
    bounds,
    plan,
    set_up,
)
from tests.models.planning.test_waters import AREA, QUAY, WALL, triangles

PACE = Pace(0.5, 0.5, 0.1)
T = np.linspace(0.0, 1.0, 201)[1:]
TURN = 2.0 * np.pi * T
PRIMITIVES = {
    "zig": np.column_stack([14 * T, 2 * np.sin(6 * T), 0.3 * np.sin(9 * T)]),
    "loop": np.column_stack([3 * np.sin(TURN) + 2.4 * T, 3 - 3 * np.cos(TURN), 1.2 * TURN]),
    "back": np.column_stack([-5 * T, -3 * T, -2 * T]),
}


def task(counts: dict[str, int], waters: Waters, **changes: object) -> PlanningTask:
    options: dict[str, object] = {
        "start": np.array([5.0, 5.0, 0.3]),
        "goal": np.array([54.0, 34.5, 1.5]),
        "cell_m": 2.0,
    } | changes
    return PlanningTask(waters, PRIMITIVES, counts, pace=PACE, hold=3, **options)  # type: ignore[arg-type]


def dense(found: PlannedPath) -> np.ndarray:
    """Positions along a plan, at most 2 cm apart, (N, 2)."""
    line = shapely.LineString(found.poses[:, :2])
    return shapely.get_coordinates(line.segmentize(0.02))


def assert_sound(asked: PlanningTask, found: PlannedPath) -> None:
    """What holds of every plan."""
    sailed = Counter(leg.name for leg in found.legs if leg.informative)
    assert sailed == Counter({name: n for name, n in asked.counts.items() if n})
    kept = asked.waters.distance(dense(found))
    assert np.min(kept) >= asked.waters.clearance_m - 1e-9
    np.testing.assert_allclose(found.poses[0], asked.start)
    np.testing.assert_allclose(found.poses[-1, :2], asked.goal[:2], atol=1e-9)
    turn = found.poses[-1, 2] - asked.goal[2]
    assert np.cos(turn) == pytest.approx(1.0)
    step = np.diff(found.poses, axis=0)
    assert np.max(np.abs(step[:, 2])) < 0.1  # unwrapped
    assert np.max(np.hypot(step[:, 0], step[:, 1])) < 0.3  # no jumps
    for leg in found.legs:
        if leg.informative:  # the manoeuvre is the one that was designed, moved and turned
            own = asked.primitives[leg.name]
            gaps = np.hypot(*np.diff(leg.poses[: len(own), :2], axis=0).T)
            np.testing.assert_allclose(gaps, np.hypot(*np.diff(own[:, :2], axis=0).T), atol=1e-9)


def test_a_harbour() -> None:
    asked = task({"zig": 2, "loop": 2, "back": 1}, Waters(AREA, (QUAY,), 1.0))
    found = plan(asked)
    assert_sound(asked, found)
    np.testing.assert_array_equal(plan(asked).poses, found.poses)


@settings(deadline=None, max_examples=25)
@given(
    st.lists(triangles(), max_size=4), st.integers(0, 2), st.integers(0, 2), st.integers(0, 1),
    st.floats(0.0, 2.0),
)  # fmt: skip
def test_plans_through_random_fields_are_sound(fields, zigs, loops, backs, clearance) -> None:
    asked = task(
        {"zig": zigs, "loop": loops, "back": backs}, Waters(AREA, tuple(fields), clearance)
    )
    try:
        found = plan(asked)
    except ConfigurationError as error:
        said = str(error)
        assert "\n" not in said
        return
    assert_sound(asked, found)
    assert found.cost <= sum(len(leg.poses) for leg in found.legs)


def everything(setting: Setting) -> int:
    """The least cost by exhaustion: Dijkstra over (counts, place), nothing foreseen."""
    moves, cells = setting.moves, len(setting.cells)
    begin = (tuple(int(size) - 1 for size in moves.size), setting.start)
    best, heap = {begin: 0}, [(0, begin)]
    while heap:
        cost, (left, place) = heappop(heap)
        if cost > best[(left, place)]:
            continue
        if place == setting.goal and not any(left):
            return cost
        for p in range(len(moves.end)):
            to = int(moves.end[p, place])
            if to < 0 or (p < len(left) and left[p] == 0):
                continue
            state = (tuple(c - (q == p) for q, c in enumerate(left)), to)
            total = cost + int(moves.cost[p, place // cells])
            if total < best.get(state, total + 1):
                best[state] = total
                heappush(heap, (total, state))
    return -1


SMALL = ((0.0, 0.0), (30.0, 0.0), (30.0, 24.0), (0.0, 24.0))


@settings(deadline=None, max_examples=12)
@given(st.lists(triangles(), max_size=3), st.integers(0, 2), st.integers(0, 2), st.integers(0, 3))
def test_no_path_is_cheaper(fields, zigs, backs, corner) -> None:
    ends = [(3.0, 3.0), (3.0, 20.0), (26.0, 3.0), (26.0, 20.0)]
    asked = task(
        {"zig": zigs, "back": backs}, Waters(SMALL, tuple(fields), 0.5),
        start=np.array([*ends[corner], 0.5]), goal=np.array([*ends[3 - corner], -1.0]),
    )  # fmt: skip
    try:
        setting = set_up(asked)
    except ConfigurationError:
        assume(False)
    least = everything(setting)
    if least < 0:
        with pytest.raises(ConfigurationError):
            plan(asked)
    else:
        assert plan(asked).cost == least


@settings(deadline=None, max_examples=10)
@given(st.lists(triangles(), max_size=3), st.integers(0, 10**6))
def test_the_heuristic_is_consistent(fields, seed: int) -> None:
    """h(s) <= c(s, s') + h(s') along every primitive, and 0 at the goal: never above the truth."""
    asked = task({"zig": 2, "loop": 1}, Waters(SMALL, tuple(fields), 0.5),
                 start=np.array([3.0, 3.0, 0.0]), goal=np.array([26.0, 20.0, 1.0]))  # fmt: skip
    try:
        setting = set_up(asked)
    except ConfigurationError:
        assume(False)
    moves, cells = setting.moves, len(setting.cells)
    left, ahead = bounds(moves, setting.goal)
    assert left[0] == 0
    assert ahead[setting.goal] == 0
    rng = np.random.default_rng(seed)
    for p, place in rng.permutation(np.argwhere(moves.end >= 0))[:300].tolist():
        to, stride = moves.end[p, place], int(moves.stride[p]) if p < len(moves.size) else 0
        for c in range(len(left)) if ahead[to] < UNREACHED else ():
            if stride and c // stride % moves.size[p] == 0:
                continue
            cost = int(moves.cost[p, place // cells]) + left[c - stride] + ahead[to]
            assert left[c] + ahead[place] <= cost


def test_manoeuvres_that_nothing_else_follows_need_no_passage() -> None:
    """Without manoeuvres and obstacles the way is as long as the lattice lets it be."""
    asked = task({}, Waters(AREA, (), 1.0), start=np.array([5.0, 5.0, 0.0]),
                 goal=np.array([55.0, 5.0, 0.0]))  # fmt: skip
    found = plan(asked)
    assert [leg.name for leg in found.legs] == ["straight"] * 25 + ["arrival"]
    assert found.cost == 25 * 40


@pytest.mark.parametrize(
    ("obstacles", "changes", "message"),
    [
        ((QUAY,), {"start": np.array([20.0, 15.0, 0.0])},
         "start at (20, 15) m: it is 0 m from the nearest edge or obstacle (0: no water)"),
        ((QUAY,), {"goal": np.array([70.0, 15.0, 0.0])}, "goal at (70, 15) m: it is 0 m from"),
        ((QUAY, WALL), {}, "no sequence of the manoeuvres with arcs and turns between them"),
        ((QUAY,), {"cell_m": 0.01}, "cell_m: got 0.01 m, with "),
        ((QUAY,), {"cell_m": 0.2, "counts": {"zig": 6, "loop": 6, "back": 6}},
         f"and {MOST_STATES:.2g}; use a larger cell_m or fewer sub-experiments"),
    ],
)  # fmt: skip
def test_an_impossible_task_is_answered(obstacles, changes, message) -> None:
    counts = changes.get("counts", {"zig": 1, "loop": 1})
    changes = {name: value for name, value in changes.items() if name != "counts"}
    with pytest.raises(ConfigurationError) as caught:
        plan(task(counts, Waters(AREA, obstacles, 1.0), **changes))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_manoeuvre_that_fits_nowhere_is_named() -> None:
    narrow = ((0.0, 0.0), (40.0, 0.0), (40.0, 6.0), (0.0, 6.0))
    ends = {"start": np.array([3.0, 3.0, 0.0]), "goal": np.array([37.0, 3.0, 0.0])}
    assert plan(task({"zig": 1}, Waters(narrow, (), 0.5), cell_m=1.0, **ends)).cost > 0
    both = task({"zig": 1, "loop": 1}, Waters(narrow, (), 0.5), cell_m=1.0, **ends)
    with pytest.raises(ConfigurationError, match=r"^loop takes .* m across .* does not fit any"):
        plan(both)


def test_a_manoeuvre_that_cannot_be_got_to_is_answered() -> None:
    """The loop fits behind a gate that the lattice has no way through."""
    left = ((28.0, -1.0), (32.0, -1.0), (32.0, 17.0), (28.0, 17.0))
    right = ((28.0, 18.7), (32.0, 18.7), (32.0, 41.0), (28.0, 41.0))
    low = ((-1.0, 7.0), (28.0, 7.0), (28.0, 41.0), (-1.0, 41.0))
    asked = task({"loop": 1}, Waters(AREA, (left, right, low), 0.8),
                 start=np.array([3.0, 3.0, 0.0]), goal=np.array([20.0, 3.0, 0.0]))  # fmt: skip
    with pytest.raises(ConfigurationError, match="no sequence of the manoeuvres"):
        plan(asked)
