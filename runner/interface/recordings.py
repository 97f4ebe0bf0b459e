"""Recordings as objects: read from a file or a frame, and cut into blocks."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn, Self

import numpy as np

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.notation import DOFS, accelerations_of, poses_of, velocities_of
from seatrial.models.recording import recording as recordings
from seatrial.models.recording.recorded_file import RecordedFile
from seatrial.models.recording.recording import UNIFORMITY, attitude_of, blocks, half
from seatrial.models.recording.signals import GAP, central_difference
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.parameters import VesselParameters
from seatrial.runner.compare.grid import grid_of
from seatrial.runner.configuration.config import build_as
from seatrial.runner.interface.arguments import overrides_of, text_of
from seatrial.runner.interface.displayed_table import Table
from seatrial.runner.interface.vessel_models import Model, motion_frame

if TYPE_CHECKING:
    import pandas as pd

    from seatrial.runner.sweeps import in_process
else:
    import lazy_loader

    pd = lazy_loader.load("pandas")
    in_process = lazy_loader.load("seatrial.runner.sweeps.in_process", suppress_warning=True)


@dataclass(frozen=True, eq=False, repr=False)
class Recording(recordings.Recording):
    """A recording of a vessel: motion and commanded force, uniformly sampled, SI units, radians."""

    @classmethod
    def from_csv(
        cls, path: str | Path, vessel: str | Path | Model = "milliampere", **options_: object
    ) -> Self:
        """Read a measured CSV file, as `excitation=recording` does.

        Args:
            path: the file, with one header line.
            vessel: the vessel, whose degrees of freedom are read.
            **options_: options of `conf/excitation/recording.yaml`, such as `start_s=10.0` or
                `columns={"time": "t", "velocity": {"surge": "u"}}`. The names of columns, their
                signs and `heading_deg=180` are by default those of the Beluga recordings.

        Returns:
            The samples between `start_s` and `end_s`.

        Raises:
            RecordingError: The file cannot be read; the message names line and column.
            ConfigurationError: An option or a column is wrong.
        """
        own = {f"excitation.{name}": value for name, value in options_.items()}
        words = [f"vessel={text_of(vessel)}", "excitation=recording", *overrides_of(own)]
        config = in_process.composed([*words, f"excitation.path={text_of(path)}"]).config
        reader = build_as(RecordedFile, config["excitation"], "excitation")
        dofs = build_as(VesselParameters, config["vessel"], "vessel").dofs
        reader.check(dofs)
        return cls.of(reader.read(dofs))

    @classmethod
    def from_frame(cls, frame: "pd.DataFrame", dofs: Sequence[str] | None = None) -> Self:
        """Make a recording of a frame with the columns of a stored series.

        Args:
            frame: time t [s] as the index or a column, or a DatetimeIndex; for surge, sway and yaw
                the pose `x, y, psi` [m, rad], the body velocity `u, v, r` [m/s, rad/s] and the
                commanded force `tau_surge, tau_sway, tau_yaw` [N, Nm]. If the acceleration `u_dot,
                v_dot, r_dot` is missing, the velocity is differentiated. `tau_actual_surge, ...` is
                the acting force, if measured.
            dofs: degrees of freedom; by default those whose velocity is there.

        Returns:
            The samples of the frame.

        Raises:
            RecordingError: A column is missing, a number is not finite, or the time steps are not
                equal.
        """
        if isinstance(frame.index, pd.DatetimeIndex) and "t" not in frame and len(frame):
            seconds = (frame.index - frame.index[0]).total_seconds()
            frame = frame.set_axis(pd.Index(seconds, name="t"))
        table = frame.reset_index() if frame.index.name == "t" else frame
        if dofs is None:
            dofs = [dof for dof in DOFS if velocities_of((dof,))[0] in table]
        axes = tuple(dofs)
        t = _columns(table, ["t"])[:, 0]
        if len(t) < 2:
            raise RecordingError(f"frame: got {len(t)} rows, expected at least 2")
        steps = np.diff(t)
        period_s = float(np.median(steps))
        deviations = np.where(steps < GAP * period_s, np.abs(steps - period_s), 0.0)  # else a gap
        worst = int(np.argmax(deviations))
        if period_s <= 0.0 or deviations[worst] > UNIFORMITY * period_s:
            raise RecordingError(
                f"frame, row {worst + 1}: got a step of {steps[worst]:g} s, "
                f"expected {period_s:g} s (of a file, resample_hz makes them equal)"
            )
        eta, nu = (_columns(table, list(names(axes))) for names in (poses_of, velocities_of))
        rates = list(accelerations_of(axes))
        known = all(name in table for name in rates)
        nu_dot = _columns(table, rates) if known else central_difference(nu, period_s)
        tau = _columns(table, [f"tau_{dof}" for dof in axes])
        acting = [f"tau_actual_{dof}" for dof in axes]
        tau_actual = _columns(table, acting) if all(name in table for name in acting) else None
        attitude = attitude_of(axes, eta)
        return cls(axes, t, eta, nu, nu_dot, tau, attitude, tau_actual=tau_actual)

    @classmethod
    def of(cls, recording: recordings.Recording) -> Self:
        """Return a recording of the models as one of this interface."""
        return cls(**{field.name: getattr(recording, field.name) for field in fields(recording)})

    def to_frame(self) -> "pd.DataFrame":
        """Return the columns that `from_frame` reads, by time t [s]."""
        frame = motion_frame(self.t, self.dofs, self.eta, self.nu)
        frame[list(accelerations_of(self.dofs))] = self.nu_dot
        for name, values in (("tau", self.tau), ("tau_actual", self.tau_actual)):
            if values is not None:
                frame[[f"{name}_{dof}" for dof in self.dofs]] = values
        return frame

    def split(self, fraction: float = 0.5) -> "tuple[Recording, Recording]":
        """Return the first `fraction` of the samples, to train on, and the rest, to test on."""
        parts = half(len(self), fraction)
        return self.part(parts.train), self.part(parts.test)

    def blocks(self, count: int, gap_s: float = 0.0) -> "list[Recording]":
        """Cut the recording into blocks of time, for a cross-validation.

        Args:
            count: number of blocks, of equal length.
            gap_s: time [s] that is left out at the end of every block but the last, so that a model
                is not tested on samples next to those it was fitted to.

        Returns:
            The blocks, in the order of time.
        """
        gap = round(gap_s / self.period_s)
        if count < 1 or gap < 0 or len(self) // count - gap < 2:
            raise ConfigurationError(
                f"blocks: got {count} blocks with gaps of {gap_s:g} s from {len(self)} samples of "
                f"{self.period_s:g} s, expected at least two samples in each"
            )
        cuts = blocks(len(self), count)
        ends = [*(cut.stop - gap for cut in cuts[:-1]), cuts[-1].stop]
        return [self.part(slice(cut.start, end)) for cut, end in zip(cuts, ends, strict=True)]

    def part(self, mask: recordings.Mask | slice) -> "Recording":
        """The recording restricted to the samples of a mask (N,) or slice."""
        return Recording.of(super().part(mask))

    def __array__(self, *arguments: object, **keywords: object) -> NoReturn:
        """Refuse to be an array: a cross-validation must not mix samples that are neighbours."""
        raise ConfigurationError(
            "X: got one recording, expected a list of recordings: recording.blocks(10) cuts one"
        )

    def __repr__(self) -> str:
        return str(self._shown())

    def _repr_html_(self) -> str:
        return self._shown().text("html")

    def _shown(self) -> Table:
        title = (
            f"recording of {', '.join(self.dofs)}: {len(self)} samples of {self.period_s:g} s, "
            f"t = {self.t[0]:g} to {self.t[-1]:g} s"
        )
        kinds = ("min", "mean", "max", "std")
        rows = [[name, *map(float, own.agg(list(kinds)))] for name, own in self.to_frame().items()]
        return Table(grid_of(title, ("column", *kinds), rows))


def _columns(table: "pd.DataFrame", names: list[str]) -> Array:
    """Return columns as an array (N, k); raises RecordingError if they cannot be used."""
    missing = [name for name in names if name not in table]
    if missing or not names:
        raise RecordingError(
            f"frame: no column {missing[0] if missing else 'of a velocity'!r}, expected "
            f"{', '.join(names) or 'u, v, w, p, q or r'}; it has {', '.join(map(str, table))}"
        )
    values = np.array(table[names], dtype=np.float64)
    wrong = np.argwhere(~np.isfinite(values))
    if len(wrong):
        row, column = wrong[0]
        raise RecordingError(
            f"frame, column {names[column]}, row {row}: got {values[row, column]}, "
            "expected a finite number"
        )
    return values
