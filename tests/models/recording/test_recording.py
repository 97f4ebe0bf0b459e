"""Recordings: forces, gaps, parts, splits and the zero-phase low-pass."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.recording.recording import Recording, blocked_k_fold
from seatrial.models.vessel.thruster import SecondOrderLag, acting_force


def make(n: int = 1200, period: float = 0.1, seed: int = 0) -> Recording:
    rng = np.random.default_rng(seed)
    t = period * np.arange(n)
    signals = rng.normal(size=(4, n, 1))
    return Recording(("surge",), t, *signals, attitude=np.zeros((n, 3)))


def test_the_force_is_filtered_where_the_lag_is_known() -> None:
    recording, lag = make(), SecondOrderLag(2.0, 0.8)
    assert recording.force(None) is recording.tau
    known = recording.with_thruster(lag)
    np.testing.assert_array_equal(known.force(None), acting_force(lag, recording.tau, 0.1))
    assert known.force("commanded") is recording.tau
    with pytest.raises(ConfigurationError, match="actual, but it is not recorded"):
        known.force("actual")
    with pytest.raises(ConfigurationError, match="filtered, but the thruster lag is not known"):
        recording.force("filtered")


def test_a_low_pass_shifts_nothing_and_treats_all_signals_alike() -> None:
    recording = make()
    slow = np.sin(2 * np.pi * 0.05 * recording.t)[:, None]
    fast = np.sin(2 * np.pi * 2.0 * recording.t)[:, None]
    mixed = Recording(
        ("surge",), recording.t, slow, slow + fast, slow + fast, slow + fast,
        attitude=recording.attitude,
    )  # fmt: skip
    smooth = mixed.lowpass(0.5)
    kept = slice(20, len(recording) - 20)
    np.testing.assert_array_equal(smooth.t, recording.t[kept])
    for name in ("nu", "nu_dot", "tau"):
        inner = slice(100, -100)  # away from the ends, where a filter has no neighbours
        np.testing.assert_allclose(getattr(smooth, name)[inner], slow[kept][inner], atol=1e-4)


def test_a_low_pass_does_not_run_across_a_gap() -> None:
    recording = make()
    trips = (recording.t < 40.0) | (recording.t >= 80.0)
    parts = recording.part(trips)
    assert parts.period_s == pytest.approx(0.1)
    first, second = parts.pieces()
    smooth = parts.lowpass(0.5)
    expected = np.vstack([first.lowpass(0.5).nu, second.lowpass(0.5).nu])
    np.testing.assert_array_equal(smooth.nu, expected)
    assert smooth.t[-1] == pytest.approx(119.9 - 2.0)


@pytest.mark.parametrize("cutoff", [0.0, -1.0, 5.0, 9.0])
def test_a_cutoff_outside_the_band_is_refused(cutoff: float) -> None:
    with pytest.raises(ConfigurationError, match="lowpass_hz must lie between 0 and 5, got"):
        make().lowpass(cutoff)


def test_a_piece_starts_after_every_gap() -> None:
    recording = make(40)
    np.testing.assert_array_equal(np.flatnonzero(recording.piece_starts), [0])
    later = np.repeat([0.0, 0.04, 0.5], [10, 10, 20])  # 0.04 s more than 0.1 s is no gap
    late = replace(recording, t=recording.t + later)
    np.testing.assert_array_equal(np.flatnonzero(late.piece_starts), [0, 20])
    assert [len(piece) for piece in late.pieces()] == [20, 20]


def test_a_command_is_held_and_an_acting_force_runs_straight() -> None:
    recording = replace(make(4), tau=np.array([[1.0], [3.0], [2.0], [5.0]]))
    recording = replace(recording, tau_actual=recording.tau.copy())
    held, acting = recording.held_force("commanded"), recording.held_force("actual")
    np.testing.assert_array_equal(held[..., 0], [[1.0] * 3, [3.0] * 3, [2.0] * 3, [5.0] * 3])
    np.testing.assert_array_equal(
        acting[..., 0], [[1.0, 2.0, 3.0], [3.0, 2.5, 2.0], [2.0, 3.5, 5.0], [5.0, 5.0, 5.0]]
    )


@given(st.integers(4, 80), st.integers(2, 4))
def test_blocks_of_nearly_equal_size_are_left_out_in_turn(n: int, count: int) -> None:
    splits = blocked_k_fold(n, count)
    tested = [np.flatnonzero(split.test) for split in splits]
    np.testing.assert_array_equal(np.concatenate(tested), np.arange(n))
    assert np.ptp([len(block) for block in tested]) <= 1
    for split in splits:
        np.testing.assert_array_equal(split.train, ~split.test)


def test_what_cannot_be_split() -> None:
    with pytest.raises(ConfigurationError, match="cannot cut 2 samples into 3 blocks"):
        blocked_k_fold(2, 3)
    with pytest.raises(ConfigurationError, match="at least 2 blocks"):
        blocked_k_fold(5, 1)


def test_pieces_too_short_for_the_filter_are_left_out() -> None:
    """A recording of 40 s, a gap, and 2 s: the filter keeps what lies inside of the first."""
    t = np.concatenate([0.1 * np.arange(400), 50.0 + 0.1 * np.arange(20)])
    one = np.ones((len(t), 1))
    recording = Recording(("surge",), t, 0.0 * one, one, one, one, np.zeros((len(t), 3)))
    smooth = recording.lowpass(1.0, 2.0)
    assert (smooth.t[0], smooth.t[-1]) == pytest.approx((2.0, 37.9))
    np.testing.assert_allclose(smooth.nu, 1.0)
    with pytest.raises(RecordingError, match="got 20 samples, too few for a low-pass filter"):
        recording.part(slice(400, None)).lowpass(1.0, 2.0)
    with pytest.raises(RecordingError, match="expected at least 2"):
        make(1)
