"""The informative mix of the modulus ship: what is designed is what is sailed, along a plan too."""

from functools import cache
from typing import Any

import numpy as np
import pytest

from seatrial.models.errors import ConfigurationError
from seatrial.models.excitation.information import log_det
from seatrial.models.excitation.optimal_design import OptimalDesign
from seatrial.models.notation import PLANAR
from seatrial.models.recording.recording import Recording
from seatrial.models.simulation.loop import sail
from seatrial.models.simulation.voyage import Voyage, recording_of
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.parameters import Plant
from seatrial.models.vessel.table import Vessel
from seatrial.runner.trials.trial import check
from tests.models.control.sailing import weather
from tests.trials import composed

PERIOD_S = 0.1
# The reference of a passage moves at 0.5 m/s at once. 3 N, less the drag of 1.25 N at that speed,
# bring 26 kg to it in v^2 / (2 a) at most.
RUN_UP = 0.5**2 / (2.0 * (3.0 - 1.25) / 26.0)
DESIGN = ("vessel=modulus_ship", "excitation=optimal_design", "controller=none")
BASIN = (
    "excitation.length_s=60", "excitation.route.area=[[0,0],[60,0],[60,40],[0,40]]",
    "excitation.route.obstacles=[[[15,10],[30,10],[30,20],[15,20]],"
    "[[40,25],[45,22],[48,30],[41,33]]]",
    "excitation.route.start=[5,5,0]", "excitation.route.goal=[55,35,90]",
)  # fmt: skip


@cache
def trial(*overrides: str) -> Any:
    return composed(*DESIGN, *overrides)


def mix(*overrides: str) -> OptimalDesign:
    found: OptimalDesign = trial(*overrides).excitation
    return found


def voyage(design: OptimalDesign, plant: Plant) -> Voyage:
    """The mix, sailed by a vessel in calm water."""
    n = len(design.schedule)
    t, rng = PERIOD_S * np.arange(n), np.random.default_rng(0)
    steering = design.steering(PLANAR, PERIOD_S)
    assert steering is not None
    return sail(
        plant, weather(n), design.guidance(t, design.start),
        design.reference_filter.table(PERIOD_S), steering, design.start, PERIOD_S, 0.1,
        added=design.force(t, PLANAR, rng),
    )  # fmt: skip


def sailed(design: OptimalDesign) -> Recording:
    """The recording of a mix by the nominal model."""
    found = voyage(design, design.plant)
    return recording_of(found, found.weather)


def test_the_whole_mix_is_better_than_random_ones() -> None:
    one = mix()
    best = log_det(one.gammas, np.array(list(one.counts.values())))
    pool = ("excitation.design=random", "excitation.repeats=1")
    draws = [mix(*pool, f"seed={seed}") for seed in range(6)]
    for drawn in draws:
        counts = np.array(list(drawn.counts.values()))
        assert (counts.sum(), counts.max()) == (6, 1)  # the pool has each once
        assert log_det(one.gammas, counts) < best
    assert len({tuple(drawn.counts.values()) for drawn in draws}) > 3


def test_the_information_is_that_of_what_is_sailed() -> None:
    """Every sub-experiment begins at rest, so the mix has the sum of its parts' information."""
    one = mix()
    recording = sailed(one)
    first = np.array(one.schedule.edges[:-1:2])
    np.testing.assert_allclose(recording.nu[first], 0.0, atol=1e-6)
    assert np.min(np.max(np.abs(recording.nu), axis=0)) > 0.1
    training = recording.part(one.schedule.mask("training"))
    phi = basis.evaluate(one.plant.vessel.terms, training.variables())
    size = np.sqrt(np.mean(phi**2, axis=0))
    gamma = (phi / size).T @ (phi / size) / len(phi)
    weights = np.array(list(one.counts.values())) / 6.0
    mixed = np.tensordot(weights, one.gammas, axes=1)
    root = np.sqrt(np.diag(mixed))
    np.testing.assert_allclose(gamma, mixed / np.outer(root, root), atol=2e-3)


def test_a_manoeuvre_again_is_the_same_motion() -> None:
    """A zig-zag begins anew each time, with its first steering to starboard."""
    names = "excitation.held_out=[zigzag_20,zigzag_20]"
    recording = sailed(mix(names))
    zigzags = recording.part(mix(names).schedule.mask("testing")).pieces()
    assert len(zigzags) == 2
    np.testing.assert_allclose(zigzags[0].nu, zigzags[1].nu, atol=1e-5)
    turn = np.degrees(zigzags[0].eta[:, 2] - zigzags[0].eta[0, 2])
    assert 20.0 < np.max(turn) < 60.0
    assert -60.0 < np.min(turn) < -20.0


def test_training_is_the_mix_and_testing_what_is_held_out() -> None:
    """Along a plan too, where passages lie between the sub-experiments."""
    for one, samples in ((mix(), 1200), (trial(*BASIN).excitation, 600)):
        split = one.split(PERIOD_S * np.arange(len(one.schedule)))
        assert sum(seconds for seconds, _ in one.rows()) == pytest.approx(one.duration_s)
        assert np.sum(split.train) == 6 * samples
        assert np.sum(split.test) == 3 * samples
        assert not np.any(split.train & split.test)
        if one.plan is None:  # else they have the order of the plan
            assert np.max(np.flatnonzero(split.train)) < np.min(np.flatnonzero(split.test))
        testing = [part.name for part in one.schedule.phases if part.role == "testing"]
        assert sorted(testing) == sorted(one.held_out)


def test_the_nominal_model_may_be_wrong() -> None:
    nominal = trial().vessel.nominal()
    wrong = [
        mix("excitation.nominal.error=0.2", f"excitation.nominal.seed={seed}") for seed in (1, 2)
    ]
    tables = [one.plant.vessel.theta for one in wrong]
    for table in tables:
        ratio = table[nominal.theta != 0.0] / nominal.theta[nominal.theta != 0.0]
        assert 0.1 < np.max(np.abs(ratio - 1.0)) <= 0.2
    assert np.max(np.abs(tables[0] - tables[1])) > 0.0
    assert mix().plant.vessel.theta == pytest.approx(nominal.theta)


def test_a_vessel_that_takes_no_forces_is_refused_before_anything_is_sailed() -> None:
    with pytest.raises(ConfigurationError, match="commands forces, but mariner is commanded by"):
        check(composed("vessel=mariner", "excitation=optimal_design"))


def off_the_plan(asked: Any, model: Vessel) -> Array:
    """Distance [m] from the plan at every sample of a vessel that sails it."""
    log = voyage(asked.excitation, asked.vessel.plant(model)).log
    planned = asked.excitation.plan.poses[: len(log.eta)]
    return np.asarray(np.hypot(*(log.eta - planned)[:, :2].T))


def test_the_nominal_vessel_sails_its_plan() -> None:
    asked = trial(*BASIN)
    gap = off_the_plan(asked, asked.vessel.nominal())
    assert np.max(gap) < RUN_UP
    assert np.median(gap) < 0.02
    assert gap[-1] < 0.1


def test_another_vessel_keeps_to_the_plan_by_feedback() -> None:
    """The true ship is 15 % lighter; without feedback it would stray by metres."""
    asked = trial(*BASIN)
    assert np.max(off_the_plan(asked, asked.plant.scale * asked.vessel.nominal())) < RUN_UP


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["excitation.held_out=[]"], "held_out: got none, expected some of zigzag_10"),
        (["excitation.held_out=[spiral]"], "held_out: got spiral, expected some of zigzag_10"),
        (["excitation.nominal.error=1.5"], "nominal.error must be below 1.0, got 1.5"),
        (
            ["excitation.design=random", "excitation.sub_experiments=56"],
            "sub_experiments must be at most the pool's 55, got 56",
        ),
        (["excitation.sub_experiments=1", "excitation.held_out=[circle]",
          "~excitation.candidates.prbs_ahead", "~excitation.candidates.prbs_aside",
          "~excitation.candidates.multisine", "~excitation.candidates.four_corner"],
         "1 of the optimal mix do not separate"),
        (
            ["vessel.tuning.excitation.amplitude.surge=2.5"],
            "excitation.candidates.prbs_ahead: the force reaches 3.5 in surge",
        ),
        (
            ["excitation.candidates.prbs_ahead.loop=closed"],
            "excitation.candidates.prbs_ahead: expected a mission by forces in an open loop",
        ),
        (["excitation.feedback.kp=[1,1]"], "excitation.feedback: expected three numbers"),
        ([*BASIN, "excitation.route.start=[20,15,0]"],
         "start at (20, 15) m: it is 0 m from"),
        ([*BASIN, "excitation.route.goal=[99,15,0]"],
         "goal at (99, 15) m: it is 0 m from"),
        ([*BASIN, "excitation.route.area=[[0,0],[60,0],[60,10],[0,10]]",
          "excitation.route.goal=null", "excitation.route.clearance_m=4.5",
          "excitation.route.obstacles=[]"],
         "does not fit anywhere in the area between the obstacles"),
        ([*BASIN, "excitation.route.area=null"], "area: expected at least three corners"),
        ([*BASIN, "excitation.route.area=[[0,0],[1,1]]"],
         "area: expected at least three corners"),
    ],
)  # fmt: skip
def test_what_cannot_work_is_refused_in_one_line(overrides: list[str], message: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        check(composed(*DESIGN, *overrides))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
