"""Parts one after the other: masks, edges, velocities, and the feedback between manoeuvres."""

import numpy as np
import pytest

from seatrial.models.errors import ConfigurationError
from seatrial.models.excitation.missions import Mission, ZigZag
from seatrial.models.excitation.schedule import (
    FOLLOW,
    OPEN,
    STOP,
    ZIGZAG,
    Gains,
    Interval,
    Schedule,
    SequenceTable,
    body_velocities,
)
from seatrial.models.simulation.registry import CONTROLLERS

DOFS = ("surge", "sway", "yaw")
GAINS = Gains((10.0, 10.0, 5.0), (20.0, 30.0, 4.0))
LIMITS = np.array([3.0, 4.0, 2.0])


class Push(Mission):
    """A steady force ahead, with or without a zig-zag's moment after two instants."""

    def __init__(self, swinging: bool) -> None:
        self.swinging = swinging

    def force(self, t, dofs, rng) -> np.ndarray:
        return np.tile([1.0, 0.0, 0.0], (len(t), 1))

    def zigzag(self, dofs, period_s):
        return ZigZag(2, 0.5, 0.3, 2) if self.swinging else None

    def guidance(self, t, start):
        raise NotImplementedError


def schedule() -> Schedule:
    poses = np.column_stack([np.linspace(0.0, 1.0, 4), np.zeros(4), np.zeros(4)])
    parts = (
        Interval("swing", "manoeuvre", 5, "training"), Interval("swing", "stop", 3),
        Interval("push", "manoeuvre", 4, "testing"), Interval("home", "passage", 4, poses=poses),
    )  # fmt: skip
    return Schedule(parts, {"swing": Push(True), "push": Push(False)}, DOFS, 0.1)


def test_every_instant_has_its_mode_and_force() -> None:
    plan = schedule()
    table, _ = plan.steering(GAINS, LIMITS)
    assert len(plan) == 16
    assert table.mode.tolist() == [OPEN] * 2 + [ZIGZAG] * 3 + [STOP] * 3 + [OPEN] * 4 + [FOLLOW] * 4
    assert plan.force()[:, 0].tolist() == [1.0] * 5 + [0.0] * 3 + [1.0] * 4 + [0.0] * 4
    assert np.flatnonzero(plan.mask("training")).tolist() == [0, 1, 2, 3, 4]
    assert np.flatnonzero(plan.mask("testing")).tolist() == [8, 9, 10, 11]


def command(table: SequenceTable, k: int, eta: list[float], nu: list[float]) -> np.ndarray:
    """The force of the step at an instant."""
    tau, rest = np.zeros(3), np.zeros(3)
    CONTROLLERS[SequenceTable](
        table, np.array([float(k), 1.0, 0.0, 0.0]), np.array(eta), np.array(nu), rest, rest, rest,
        tau, np.zeros(3),
    )  # fmt: skip
    return tau


def test_a_stop_takes_energy_out_within_the_limits() -> None:
    table, _ = schedule().steering(GAINS, LIMITS)
    nu = [0.05, -0.5, 0.01]
    tau = command(table, 5, [1.0, 2.0, 3.0], nu)
    np.testing.assert_allclose(tau, [-1.0, 4.0, -0.04])  # sway at its limit
    assert tau @ nu < 0.0


def test_a_passage_is_followed_in_body_axes_the_short_way_round() -> None:
    table, _ = schedule().steering(GAINS, LIMITS)
    ahead = table.velocities[15, 0]
    assert ahead == pytest.approx(10.0 / 3.0)
    east = command(table, 15, [1.0, -0.1, 0.5 * np.pi], [ahead, 0.0, 0.0])
    assert east[0] == pytest.approx(1.0)  # the pose is ahead of a vessel that heads east
    assert east[1] == pytest.approx(0.0, abs=1e-12)
    turned = command(table, 15, [1.0, 0.0, 2.0 * np.pi - 0.1], [ahead, 0.0, 0.0])
    assert turned[2] == pytest.approx(0.5)


def test_velocities_of_poses_are_those_of_a_circle() -> None:
    t = np.arange(0.0, 10.0, 0.01)
    circle = np.column_stack([2.0 * np.sin(0.3 * t), 2.0 - 2.0 * np.cos(0.3 * t), 0.3 * t])
    found = body_velocities(circle, 0.01)[1:-1]
    np.testing.assert_allclose(found, np.tile([0.6, 0.0, 0.3], (len(found), 1)), atol=1e-5)


def test_gains_are_not_negative() -> None:
    with pytest.raises(ConfigurationError, match="kd must not be negative"):
        Gains((1.0, 1.0, 1.0), (1.0, -1.0, 1.0))
