"""Interface of the readers of measured recordings; `recorded_file` implements it for CSV files."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path

from seatrial.models.recording.examination import Examination
from seatrial.models.recording.preprocessing import Description
from seatrial.models.recording.recording import Recording, Split, half
from seatrial.models.vessel.basis import Array


class Reader(ABC):
    """A measured recording as excitation, which is read instead of simulated."""

    def check(self, dofs: Sequence[str]) -> None:  # noqa: B027 - every vessel is accepted
        """Raise ConfigurationError if the recording does not suit a vessel; does not read it."""

    def files(self) -> dict[str, Path]:
        """Paths of the files that are read, by option."""
        return {}

    @abstractmethod
    def read(self, dofs: Sequence[str]) -> Recording:
        """Read the recording of a vessel with these degrees of freedom; raises RecordingError."""

    def split(self, t: Array) -> Split:
        """Training and test samples of the recording that `read` returns; times t [s], (N,)."""
        return half(len(t))

    def split_of(self, recording: Recording) -> Split:
        """Training and test samples of the recording that `read` returns."""
        return self.split(recording.t)

    def describe(self) -> tuple[Description, ...]:
        """Descriptive statistics of the recorded columns."""
        return ()

    def examine(self, dofs: Sequence[str]) -> Examination | None:
        """Whether pose and velocity belong together; None if they cannot be compared."""
        return None

    @property
    def trusted(self) -> bool:
        """Whether the recording is taken also if pose and velocity do not belong together."""
        return False

    def outlier_counts(self, dofs: Sequence[str]) -> dict[str, int]:
        """Number of outliers in each column."""
        return {}
