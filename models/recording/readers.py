"""What every reader of measured recordings is asked; `recorded_file` is the one of CSV files."""

from abc import ABC, abstractmethod
from collections.abc import Sequence

from seatrial.models.recording.preprocessing import Description
from seatrial.models.recording.recording import Recording, Split, half
from seatrial.models.vessel.basis import Array


class Reader(ABC):
    """A measured recording as excitation: read, not simulated."""

    def check(self, dofs: Sequence[str]) -> None:  # noqa: B027 - nothing to refuse
        """Raise ConfigurationError for a vessel that it cannot serve; reads nothing."""

    @abstractmethod
    def read(self, dofs: Sequence[str]) -> Recording:
        """The recording of a vessel of these degrees of freedom; raises RecordingError."""

    def split(self, t: Array) -> Split:
        """Which of the samples that `read` gave are for training and which for testing."""
        return half(len(t))

    def describe(self) -> tuple[Description, ...]:
        """Statistics of what was recorded, column by column."""
        return ()

    def outlier_counts(self, dofs: Sequence[str]) -> dict[str, int]:
        """How many samples of each column are outliers."""
        return {}
