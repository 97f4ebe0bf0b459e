"""An identified model that is on no axis worse than knowing nothing.

Every block of the training part is predicted by free runs of a model that was identified without
it, and of the nominal one (`blocked_free_run`). An axis that is predicted worse keeps its nominal
equation; then the rest is judged again, since the equations act on each other.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from seatrial.models.findings import Finding
from seatrial.models.identification.blocked_free_run import UNUSABLE, Blocks, LeftOut
from seatrial.models.identification.physical_constraints import unphysical
from seatrial.models.identification.problem import Identified, Problem
from seatrial.models.identification.spread import TableSpread
from seatrial.models.recording.recording import Recording
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel

LOST = "worse_than_nominal"  # the finding of an axis
RUNAWAY = 2.0  # error over the spread of the motion: twice that of its mean


@dataclass(frozen=True, eq=False)
class TrainingPart(Blocks):
    """The whole training part in place of blocks, to judge a model that is fitted to it."""

    @cached_property
    def left_out(self) -> tuple[Recording, ...]:
        """The training part, with smoothed velocities."""
        return (self.smoothed,)


class Runaway(TrainingPart):
    """Judges a regression: an axis is lost that is worse than the nominal model and runs away.

    A regression minimises the error of the force, so its free runs over the same part may be a
    little worse; with twice the error of the mean motion they say that it has failed.
    """

    def lost(self, left_out: LeftOut, reference: LeftOut) -> list[int]:
        """The axes that are worse than a reference, and whose error is above RUNAWAY."""
        nrmse = dict(zip(self.axes, left_out.nrmse, strict=True))
        return [k for k in super().lost(left_out, reference) if nrmse[k] > RUNAWAY]


def held_to_nominal(part: TrainingPart, result: Identified) -> Identified:
    """The result with the nominal equation of each axis that it predicts worse where it was fitted.

    Free runs over the training part are compared. It costs no further estimate, and finds models
    that run away or whose regression has failed, not those that are fitted too closely.
    """
    return guarded_by([result.model], part, result)


def guarded(
    blocks: Blocks, estimate: Callable[[Problem], Vessel], result: Identified
) -> Identified:
    """The result with the nominal equation of each axis that is predicted worse with its own.

    `estimate` returns the model of a part of the recording.
    """
    try:
        models = [estimate(problem) for problem in blocks.problems]
    except UNUSABLE:
        return with_nominal_axes(result, blocks.problem.nominal, blocks.every_axis, LOST)
    return guarded_by(models, blocks, result)


def guarded_by(models: Sequence[Vessel], blocks: Blocks, result: Identified) -> Identified:
    """The same for models that were identified without each of the blocks.

    An axis that did not move, or of which the nominal model cannot be simulated, is not judged.
    """
    nominal = blocks.problem.nominal
    if not blocks.axes:
        return result
    try:
        reference = blocks.errors([nominal] * len(blocks.left_out))
    except UNUSABLE:
        return result
    lost: list[int] = []
    while new := [k for k in _lost(blocks, models, nominal, lost, reference) if k not in lost]:
        lost += new
    changed = with_nominal_axes(result, nominal, lost, LOST)
    if lost and unphysical(changed.model, nominal, blocks.problem.training.nu) is not None:
        return with_nominal_axes(result, nominal, blocks.every_axis, LOST)
    return changed


def _lost(
    blocks: Blocks, models: Sequence[Vessel], nominal: Vessel, lost: list[int], reference: LeftOut
) -> list[int]:
    """The axes on which models are worse; all where they cannot be simulated."""
    mixed = [mixed_table(model, nominal, lost) for model in models]
    try:
        return blocks.lost(blocks.errors(mixed), reference)
    except UNUSABLE:
        return blocks.every_axis


def mixed_table(model: Vessel, nominal: Vessel, axes: Sequence[int]) -> Vessel:
    """A model with the nominal equations of some axes."""
    terms = model.terms + tuple(term for term in nominal.terms if term not in model.terms)
    theta = model.on(terms).theta.copy()
    theta[:, list(axes)] = nominal.on(terms).theta[:, list(axes)]
    return replace(model, terms=terms, theta=theta)


def with_nominal_axes(
    result: Identified, nominal: Vessel, axes: Sequence[int], finding: str
) -> Identified:
    """A result with the nominal equations of some axes, each with a `finding`."""
    if not axes:
        return result

    def without(table: Array, value: float) -> Array:
        changed = table.copy()
        changed[:, list(axes)] = value
        return changed

    residual = replace(result.residual, theta=without(result.residual.theta, 0.0))
    dofs = nominal.dofs
    return replace(
        result,
        model=nominal + residual,
        residual=residual,
        std_error=None if result.std_error is None else without(result.std_error, np.nan),
        spread=result.spread if isinstance(result.spread, TableSpread) else None,
        findings=(*result.findings, *(Finding(finding, dofs[k], 1.0) for k in axes)),
    )
