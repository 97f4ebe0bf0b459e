"""Whether a recording can tell the terms of a model apart: a report before any identification.

For each degree of freedom the regressors are the terms that the model has there, each scaled to
unit size. Small singular values mean that a combination of them hardly shows in the data: that
combination cannot be identified, whatever the method. Beside it stand the spectral lines of the
force, of which a linear regression needs half as many as it has unknowns (Ljung (1999), 13.2);
they are those of the whole experiment, as more of them are resolved the longer it is.
"""

from dataclasses import dataclass

import numpy as np

from seatrial.models.recording.recording import Recording
from seatrial.models.vessel import basis
from seatrial.models.vessel.table import Vessel

INSEPARABLE = 0.01  # of a singular value, relative to the largest: noise is amplified so much
SHARE = 0.2  # of a term in a combination that counts as part of it
LINE = 0.01  # of the amplitude of a spectral line, relative to the largest


@dataclass(frozen=True)
class Persistence:
    """What a recording shows of one degree of freedom."""

    dof: str
    terms: tuple[str, ...]
    unexcited: tuple[str, ...]  # terms that are zero throughout
    inseparable: tuple[tuple[str, ...], ...]  # groups of terms, the least separable first
    condition: float  # of the scaled regressors that are excited
    rank: int
    lines: int  # spectral lines of the force

    @property
    def unknowns(self) -> int:
        """Number of terms."""
        return len(self.terms)

    @property
    def persistent(self) -> bool:
        """Whether all terms can be told apart."""
        return self.rank == self.unknowns

    def warning(self) -> str | None:
        """What cannot be told apart, in a line; None where all can."""
        parts = []
        if self.unexcited:
            parts.append(f"{', '.join(self.unexcited)} not excited")
        parts += [f"{' and '.join(group)} not told apart" for group in self.inseparable]
        if not parts:
            return None
        few = f", {self.lines} spectral lines" if 2 * self.lines < self.unknowns else ""
        seen = f"{self.rank} of {self.unknowns} terms told apart{few}"
        return f"{self.dof}: {seen}: {'; '.join(parts)}"


def persistence(
    recording: Recording, model: Vessel, whole: Recording | None = None
) -> tuple[Persistence, ...]:
    """The report over a recording, one entry a degree of freedom, for the terms of a model.

    `whole` is the experiment that the recording is a part of, where it is one.
    """
    x = recording.variables()
    tau = (whole or recording).tau
    return tuple(_of_dof(tau[:, i], model, i, x) for i in range(len(model.dofs)))


def _of_dof(force: basis.Array, model: Vessel, column: int, x: basis.Array) -> Persistence:
    used = [one for one, row in zip(model.terms, model.theta, strict=True) if row[column] != 0.0]
    phi = basis.evaluate(used, x)
    size = np.linalg.norm(phi, axis=0)
    excited = size > 0.0
    names = [one.name for one in used]
    left = [name for name, any_ in zip(names, excited, strict=True) if any_]
    _, values, ways = np.linalg.svd(phi[:, excited] / size[excited], full_matrices=False)
    rank = int(np.sum(values > INSEPARABLE * values[0])) if len(values) else 0
    groups = [_members(way, left) for way in ways[rank:][::-1]]
    return Persistence(
        dof=model.dofs[column],
        terms=tuple(names),
        unexcited=tuple(name for name, any_ in zip(names, excited, strict=True) if not any_),
        inseparable=tuple(dict.fromkeys(groups)),
        condition=float(values[0] / values[-1]) if len(values) and values[-1] > 0.0 else np.inf,
        rank=rank,
        lines=spectral_lines(force),
    )


def _members(way: basis.Array, names: list[str]) -> tuple[str, ...]:
    """The terms that make up a combination."""
    weight = np.abs(way) / np.max(np.abs(way))
    return tuple(name for name, share in zip(names, weight, strict=True) if share > SHARE)


def spectral_lines(force: basis.Array) -> int:
    """Number of frequencies in a force (N,), the mean and neighbours of a line left out.

    They are those between its first and its last sample that is not zero.
    """
    at = np.flatnonzero(force)
    if not len(at):
        return 0
    force = force[at[0] : at[-1] + 1]
    amplitude = np.abs(np.fft.rfft((force - np.mean(force)) * np.hanning(len(force))))
    if not np.max(amplitude, initial=0.0) > 1e-12 * np.max(np.abs(force), initial=0.0):
        return 0
    inner = amplitude[1:-1]
    peak = (inner >= amplitude[:-2]) & (inner > amplitude[2:])
    return int(np.sum(peak & (inner > LINE * np.max(amplitude))))
