"""Recordings: forces, parts and the zero-phase low-pass."""

import numpy as np
import pytest

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.recording.recording import Recording, blocks
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
        np.testing.assert_allclose(getattr(smooth, name)[inner], slow[kept][inner], atol=1e-3)


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


def test_too_short_a_recording_is_refused() -> None:
    with pytest.raises(RecordingError, match="too few"):
        make(40).lowpass(0.5)
    with pytest.raises(RecordingError, match="expected at least 2"):
        make(1)


def test_shapes_are_checked() -> None:
    with pytest.raises(RecordingError, match=r"nu: got shape \(3, 1\), expected \(4, 1\)"):
        Recording(
            ("surge",), np.arange(4.0), np.zeros((4, 1)), np.zeros((3, 1)), np.zeros((4, 1)),
            np.zeros((4, 1)), np.zeros((4, 3)),
        )  # fmt: skip


def test_blocks_cover_everything_once() -> None:
    covered = np.concatenate([np.arange(100)[block] for block in blocks(100, 6)])
    np.testing.assert_array_equal(covered, np.arange(100))
