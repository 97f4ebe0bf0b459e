"""Recordings from files and frames."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import seatrial as st
from seatrial.models.recording.recording import end_to_end
from tests.data import DATA


@pytest.fixture
def frame() -> pd.DataFrame:
    """u = sin t in surge, every 0.1 s."""
    t = np.arange(200) * 0.1
    return pd.DataFrame(
        {"x": 1.0 - np.cos(t), "u": np.sin(t), "tau_surge": np.cos(t)}, index=pd.Index(t, name="t")
    )


def test_a_series_becomes_the_recording_it_was(run: st.Run) -> None:
    series = run.series()
    recording = st.Recording.from_frame(series)
    assert recording.dofs == ("surge", "sway", "yaw")
    back = recording.to_frame()
    pd.testing.assert_frame_equal(back, series[list(back.columns)], check_like=True)


def test_a_missing_acceleration_is_the_slope_of_the_velocity(frame: pd.DataFrame) -> None:
    recording = st.Recording.from_frame(frame)
    np.testing.assert_allclose(recording.nu_dot[:, 0], np.cos(recording.t), atol=0.004)
    assert (recording.dofs, recording.period_s) == (("surge",), pytest.approx(0.1))


def test_a_bad_frame_is_refused(frame: pd.DataFrame) -> None:
    uneven = frame.reset_index()
    uneven.loc[50:, "t"] += 0.03
    lost = frame.assign(u=frame["u"].where(np.arange(200) != 7))
    for wrong, message in (
        (frame.drop(columns="tau_surge"), "no column 'tau_surge', expected it among t, x, u"),
        (frame[["x"]], "got 200 rows of t, x, expected at least 2, with u, v"),
        (lost, "column u, row 8: got .nan., expected a finite number"),
        (uneven, r"row 51: got .*equal steps, here 0.1 s; excitation.resample_hz"),
        (frame.iloc[::-1], r"row 2: got .*expected time to increase"),
    ):
        with pytest.raises(st.RecordingError, match=message):
            st.Recording.from_frame(wrong)
    with pytest.raises(st.RecordingError, match="frame: got int, expected columns by name"):
        st.Recording.from_frame(3)  # type: ignore[arg-type]
    with pytest.raises(st.ConfigurationError, match="resample: unknown option, did you mean resam"):
        st.Recording.from_frame(frame, resample=10.0)


def test_a_frame_is_read_as_a_file_is(frame: pd.DataFrame) -> None:
    """Dates are times, gaps begin a new piece, and unequal steps are resampled where asked."""
    dated = frame.set_axis(pd.Timestamp("2024-05-01") + pd.to_timedelta(frame.index, unit="s"))
    whole, same = st.Recording.from_frame(frame), st.Recording.from_frame(dated)
    np.testing.assert_allclose(same.t, whole.t, atol=1e-8)
    np.testing.assert_allclose(same.nu, whole.nu)
    parted = st.Recording.from_frame(frame.drop(frame.index[50:80]))
    assert np.flatnonzero(parted.piece_starts).tolist() == [0, 50]
    even = st.Recording.from_frame(frame.drop(frame.index[50:52]), resample_hz=10.0)
    np.testing.assert_allclose(even.t, whole.t, atol=1e-9)
    np.testing.assert_allclose(even.nu, whole.nu, atol=0.02)


def test_blocks_are_consecutive_and_apart(frame: pd.DataFrame) -> None:
    recording = st.Recording.from_frame(frame)
    blocks = recording.blocks(4, gap_s=1.0)
    assert [len(block) for block in blocks] == [40, 40, 40, 50]
    for before, after in pairwise(blocks):
        assert after.t[0] - before.t[-1] == pytest.approx(1.1)
    whole = end_to_end(recording.blocks(4))
    np.testing.assert_array_equal(whole.t, recording.t)
    assert np.count_nonzero(whole.piece_starts) == 1
    assert np.count_nonzero(end_to_end([blocks[0], blocks[2]]).piece_starts) == 2
    with pytest.raises(st.RecordingError, match="got 0 samples, expected at least 2"):
        recording.blocks(4, gap_s=5.0)
    train, test = recording.split(0.25)
    assert (len(train), len(test)) == (50, 150)


def test_recordings_of_one_start_are_joined_one_after_the_other(frame: pd.DataFrame) -> None:
    recording = st.Recording.from_frame(frame)
    twice = end_to_end([recording, recording])
    assert len(twice) == 400
    assert np.count_nonzero(twice.piece_starts) == 2
    assert np.all(np.diff(twice.t) > 0.0)
    assert twice.period_s == pytest.approx(0.1)
    slow = st.Recording.from_frame(frame.iloc[::2])
    with pytest.raises(
        st.RecordingError, match=r"got surge every 0.2 s, expected surge every 0.1 s"
    ):
        end_to_end([recording, slow])


@pytest.mark.data
def test_a_csv_file_is_read_as_a_trial_reads_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    path = f"{DATA}/beluga/surge-1.csv"
    recording = st.Recording.from_csv(path, "surge_linear", start_s=5.0)
    run = st.run(
        vessel="surge_linear", excitation="recording", excitation__path=path,
        excitation__start_s=5.0, identifier="ls", controller="none", evaluation="none",
    )  # fmt: skip
    stored = run.series()
    np.testing.assert_array_equal(recording.t, stored.index)
    np.testing.assert_array_equal(recording.nu[:, 0], stored["u"])
    np.testing.assert_array_equal(recording.tau[:, 0], stored["tau_surge"])
    estimator = st.Estimator("ls", vessel="surge_linear").fit(recording.split(0.5)[0])
    own = run.model.coefficients
    np.testing.assert_allclose(estimator.model_.coefficients.loc[own.index], own, rtol=1e-9)
    with pytest.raises(st.RecordingError, match=r"none.csv: there is no such file"):
        st.Recording.from_csv("none.csv", "surge_linear")
