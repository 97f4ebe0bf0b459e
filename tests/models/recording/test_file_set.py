"""Several files as one recording."""

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from omegaconf import OmegaConf

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.recording.recorded_file import RecordedFile
from seatrial.models.recording.recording import blocks
from seatrial.runner.configuration.config import build_as
from seatrial.runner.configuration.named_files import with_map

CONF = Path(__file__).parents[3] / "conf" / "excitation" / "recording.yaml"


def reader(**options: Any) -> RecordedFile:
    """The reader of conf/excitation/recording.yaml with options, and those of their map."""
    node = OmegaConf.to_container(OmegaConf.merge(OmegaConf.load(CONF), options))
    return build_as(RecordedFile, with_map(node), "excitation")


def ramp(path: Path, slope: float, offset: float, n: int = 50, period: float = 0.1) -> Path:
    """A recording of a constant acceleration `slope`."""
    rows = ["Time,position_x,surge_vel,force_x"]
    rows += [f"{period * k},0,{offset + slope * period * k},{slope}" for k in range(n)]
    path.write_text("\n".join(rows))
    return path


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    for number, (slope, offset) in enumerate([(1.0, 0.0), (-2.0, 50.0), (3.0, -70.0), (0.5, 9.0)]):
        ramp(tmp_path / f"run{number}.csv", slope, offset, 50 + 10 * number)
    return tmp_path


def files(folder: Path, *names: str) -> list[str]:
    return [str(folder / f"{name}.csv") for name in names]


def test_nothing_is_differentiated_over_a_joint(runs: Path) -> None:
    recording = reader(train=[str(runs / "run[01].csv")], test=files(runs, "run2", "run3")).read(
        ("surge",)
    )
    assert recording.file_names == ("run0.csv", "run1.csv", "run2.csv", "run3.csv")
    assert np.bincount(recording.file).tolist() == [50, 60, 70, 80]
    np.testing.assert_allclose(recording.nu_dot, recording.tau, atol=1e-9)
    assert np.flatnonzero(recording.piece_starts).tolist() == [0, 50, 110, 180]
    assert recording.period_s == pytest.approx(0.1)


def test_nothing_is_differentiated_over_a_gap_of_a_file(tmp_path: Path) -> None:
    rows = ["Time,position_x,surge_vel,force_x"]
    for k in range(200):
        if not 80 <= k < 120:
            offset = 0.0 if k < 100 else 300.0
            rows.append(f"{0.1 * k:.10g},0,{offset + 0.1 * k:.10g},1")
    path = tmp_path / "a.csv"
    path.write_text("\n".join(rows))
    options = {"path": str(path), "resample_hz": 10.0}
    with pytest.raises(RecordingError, match=r"position_x: got no sample for 4\.1 s after 7\.9 s"):
        reader(**options).read(("surge",))
    recording = reader(**options, at_gap="split").read(("surge",))
    np.testing.assert_allclose(recording.nu_dot, 1.0, atol=1e-6)
    assert np.count_nonzero(recording.piece_starts) == 2


def test_training_and_test_files_and_the_window_before_a_free_run(runs: Path) -> None:
    excitation = reader(train=files(runs, "run0", "run1"), test=files(runs, "run2"), initial_s=2.0)
    recording = excitation.read(("surge",))
    split = excitation.split(recording.t, recording.file)
    assert np.flatnonzero(split.train).tolist() == list(range(110))
    assert np.flatnonzero(split.test).tolist() == list(range(130, 180))
    excitation = reader(train=files(runs, "run0", "run1"), train_fraction=0.8)
    recording = excitation.read(("surge",))
    split = excitation.split(recording.t, recording.file)
    assert np.flatnonzero(split.test).tolist() == [*range(40, 50), *range(98, 110)]


def test_folds_are_files(runs: Path) -> None:
    recording = reader(train=[str(runs / "*.csv")]).read(("surge",))
    for split, number in zip(recording.folds(10), range(4), strict=True):
        np.testing.assert_array_equal(split.test, recording.file == number)
        np.testing.assert_array_equal(split.train, recording.file != number)
    assert [len(part) for part in recording.by_file().values()] == [50, 60, 70, 80]


@pytest.mark.parametrize("count", [2, 3, 5, 9])
def test_more_files_than_folds_are_put_together_whole(count: int) -> None:
    rng = np.random.default_rng(count)
    lengths = rng.integers(5, 200, 9)
    file = np.repeat(np.arange(9), lengths)
    cuts = blocks(len(file), count, file)
    assert len(cuts) == count
    assert (cuts[0].start, cuts[-1].stop) == (0, len(file))
    assert all(a.stop == b.start for a, b in pairwise(cuts))
    for cut in cuts:
        assert cut.stop > cut.start
        inside = np.unique(file[cut])
        assert np.sum(lengths[inside]) == cut.stop - cut.start


def refusal(expected: type[Exception], **options: Any) -> str:
    def split() -> None:
        excitation = reader(**options)
        recording = excitation.read(("surge",))
        excitation.split(recording.t, recording.file)

    with pytest.raises(expected) as caught:
        split()
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_sets_of_files_that_are_refused(runs: Path) -> None:
    one = files(runs, "run0")
    assert "excitation.test requires excitation.train" in refusal(ConfigurationError, test=one)
    assert "path: expected null beside train" in refusal(ConfigurationError, path=one[0], train=one)
    assert "which excitation.train has too" in refusal(ConfigurationError, train=one, test=one)
    message = refusal(ConfigurationError, train=[str(runs / "turn*.csv")])
    assert "turn*.csv, which matches no file, expected recordings" in message
    assert "no such file" in refusal(RecordingError, train=files(runs, "run9"))
    message = refusal(ConfigurationError, train=one, test=files(runs, "run1"), initial_s=60.0)
    assert "initial_s: got 60 s, which leaves 0 samples for testing of" in message
    ramp(runs / "slow.csv", 1.0, 0.0, period=0.2)
    message = refusal(RecordingError, train=[*one, *files(runs, "slow")])
    assert "slow.csv: got surge every 0.2 s, expected surge every 0.1 s" in message
    assert message.endswith("resample_hz sets one")
