"""Channels on one grid, and recordings end to end."""

import numpy as np
import pytest

from seatrial.models.errors import RecordingError
from seatrial.models.recording.times import Channel, join_channels


def test_straight_lines_are_joined_exactly_and_within_all_channels() -> None:
    rng = np.random.default_rng(4)
    one, two = (np.sort(rng.uniform(a, b, 200)) for a, b in ((0.0, 9.0), (1.0, 10.0)))
    channels = {"x": Channel(one, 3.0 * one), "y": Channel(two, 1.0 - two)}
    t, values = join_channels(channels, 10.0, 1.0)
    assert t[0] == two[0]
    assert one[-1] - 0.1 < t[-1] <= one[-1]
    np.testing.assert_allclose(np.diff(t), 0.1)
    np.testing.assert_allclose(values["x"], 3.0 * t)
    np.testing.assert_allclose(values["y"], 1.0 - t)


def test_channels_that_do_not_overlap() -> None:
    early, late = np.linspace(0.0, 1.0, 5), np.linspace(2.0, 3.0, 5)
    channels = {"a": Channel(early, early, name="a"), "b": Channel(late, late, name="b")}
    with pytest.raises(RecordingError, match="b begins at 2 s, a ends at 1 s"):
        join_channels(channels, 10.0, 1.0)


def test_a_command_is_held_until_the_next_and_a_state_is_interpolated() -> None:
    t = np.array([0.0, 1.0, 2.0])
    channels = {"held": Channel(t, t, True), "state": Channel(t, t)}
    grid_t, joined = join_channels(channels, 10.0, 2.0)
    np.testing.assert_allclose(joined["state"], grid_t)
    np.testing.assert_array_equal(joined["held"], np.floor(grid_t + 1e-9))


def test_no_sample_lies_in_a_gap_and_none_is_made_from_both_its_sides() -> None:
    """A ramp with another offset after its gap: a line across the gap would show."""
    t = np.concatenate([np.arange(0.0, 5.0, 0.13), np.arange(9.0, 15.0, 0.13)])
    x = t + 100.0 * (t > 7.0)
    other = np.arange(0.0, 15.0, 0.01)
    channels = {"x": Channel(t, x, name="x"), "other": Channel(other, -other)}
    grid_t, joined = join_channels(channels, 10.0, 0.5, "split")
    last, first = t[t < 7.0][-1], t[t > 7.0][0]
    assert not np.any((grid_t > last) & (grid_t < first))
    np.testing.assert_allclose(joined["x"], grid_t + 100.0 * (grid_t > 7.0))
    np.testing.assert_allclose(joined["other"], -grid_t)
    steps = np.diff(grid_t) * 10.0  # a gap is a multiple of the sample time
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    assert np.count_nonzero(steps > 1.5) == 1
    with pytest.raises(RecordingError, match=r"x: got no sample for 4\.\d+ s after 4\.94 s"):
        join_channels(channels, 10.0, 0.5)


def test_an_old_command_is_a_gap() -> None:
    t = np.array([0.0, 1.0, 6.0, 7.0])
    clock = np.arange(0.0, 7.0, 0.1)
    channels = {"command": Channel(t, t, True), "x": Channel(clock, clock)}
    grid_t, _ = join_channels(channels, 10.0, 1.5, "split")
    age = grid_t - t[np.searchsorted(t, grid_t + 1e-9) - 1]
    assert np.max(age) <= 1.5 + 1e-6
    assert np.count_nonzero(np.diff(grid_t) > 0.15) == 1


def test_times_that_do_not_rise_are_left_out() -> None:
    """What is left of two samples cannot be joined."""
    t, notes = np.array([0.0, 1.0, 1.0, 0.5, np.nan]), list[str]()
    channel = Channel(t, np.array([5.0, 6.0, 7.0, 8.0, 9.0]), name="x").cleaned(notes)
    np.testing.assert_array_equal(channel.values, [5.0, 6.0])
    repeated = "2 samples are not later than the one before (1 times repeat, 1 go back): left out"
    assert notes == ["1 rows have no time: left out", f"x: {repeated}"]
    with pytest.raises(RecordingError, match="x: got 1 samples, expected at least 2"):
        join_channels({"x": Channel(t[:1], t[:1], name="x")}, 1.0, 1.0)
