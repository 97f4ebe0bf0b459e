"""What an identifier returns, held to the nominal model where its own equations predict worse.

Free runs over blocks of the training part are compared with those of the nominal model by the rule
of `cross_validation`. An axis that is predicted worse keeps its nominal equation; then the rest is
judged again, since the equations act on each other. It costs no further estimate, and finds models
that run away or whose regression has failed, not those that are fitted too closely: these are found
on blocks left out (`auto`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.identification.cross_validation import (
    UNUSABLE,
    BlockScore,
    CrossValidation,
    FoldErrors,
    mixed_table,
)
from seatrial.models.identification.physical_constraints import unphysical
from seatrial.models.identification.problem import Identified, Identifier, Problem, Spread, checked
from seatrial.models.recording.recording import Recording
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel

WORSE_THAN_NOMINAL = "worse_than_nominal"  # the diagnostic of an axis
NO_SKILL = "no_skill"


@dataclass(frozen=True, eq=False)
class WholeTraining(CrossValidation):
    """The whole training part as the one block, to judge a model that is fitted to it."""

    @cached_property
    def blocks(self) -> tuple[Recording, ...]:
        """The training part, with smoothed velocities."""
        return (self.smoothed,)


@dataclass(frozen=True, eq=False)
class HeldSpread(Spread):
    """The distribution of a result with the nominal equations of some axes, which are fixed."""

    spread: Spread
    nominal: Vessel
    axes: tuple[int, ...]

    def draw(
        self, result: Identified, rng: np.random.Generator, share: float = 1.0, kappa2: float = 1.0
    ) -> Vessel:
        """The model drawn, with the nominal equations."""
        drawn = self.spread.draw(result, rng, share, kappa2)
        return mixed_table(drawn, self.nominal, self.axes)


def identified(identifier: Identifier, problem: Problem, rng: np.random.Generator) -> Identified:
    """What an identifier finds, protected if it asks for that, with what is to be said of it.

    Raises IdentificationError when the data do not determine the vessel, PartError if what an
    identifier of the user returns is no model of it.
    """
    result = checked(identifier, identifier.identify(problem, rng), problem.nominal)
    if not identifier.protected:
        return result
    whole = WholeTraining(problem)
    if not whole.axes:
        return result
    models = [result.model]
    score = whole.score(models) if result.state_space is None else undivided(whole, models)
    result = held_to_nominal(result, score, problem)
    if kept := [f.dof for f in result.diagnostics if f.name == WORSE_THAN_NOMINAL]:
        note = (
            f"nominal equations: {', '.join(kept)}; there the identified ones simulate the "
            "training part worse, or neither beats the mean motion"
        )
        result = replace(result, notes=(*result.notes, note))
    return with_skill(result, whole, score.errors, "the training part")


def undivided(validation: CrossValidation, models: Sequence[Vessel]) -> BlockScore:
    """The score of models whose equations belong together, as those of a state-space model.

    All are nominal where the models are worse as a whole, or where on an axis neither they nor the
    nominal model beat the mean motion.
    """
    nominal, reference = validation.problem.nominal, validation.nominal
    fallen = BlockScore(reference, tuple(range(len(nominal.dofs))), (nominal,) * len(models))
    try:
        errors = validation.errors(models)
    except UNUSABLE:  # the model cannot be simulated
        return fallen
    no_skill = np.any(np.minimum(errors.nrmse, reference.nrmse) > 1.0)
    if no_skill or errors.worse(reference):
        return fallen
    return BlockScore(errors, (), tuple(models))


def held_to_nominal(result: Identified, score: BlockScore, problem: Problem) -> Identified:
    """The result with the nominal equations of the axes of a score.

    All equations are nominal where the mixed model would be impossible.
    """
    if not score.nominal_axes:
        return result
    nominal, every = problem.nominal, range(len(problem.nominal.dofs))
    changed = with_nominal_axes(result, nominal, score.nominal_axes, WORSE_THAN_NOMINAL)
    if unphysical(changed.model, nominal, problem.training.nu) is not None:
        return with_nominal_axes(result, nominal, every, WORSE_THAN_NOMINAL)
    return changed


def with_nominal_axes(
    result: Identified, nominal: Vessel, axes: Sequence[int], diagnostic: str
) -> Identified:
    """A result with the nominal equations of some axes, each with a `diagnostic`.

    A linear model for control, which has no nominal equations, is dropped.
    """
    if not len(axes):
        return result

    def without(table: Array, value: float) -> Array:
        changed = table.copy()
        changed[:, list(axes)] = value
        return changed

    residual = replace(result.residual, theta=without(result.residual.theta, 0.0))
    rows = [Diagnostic(diagnostic, nominal.dofs[k], 1.0) for k in axes]
    return replace(
        result,
        model=nominal + residual,
        residual=residual,
        std_error=None if result.std_error is None else without(result.std_error, np.nan),
        control_model=None,
        device_errors={},
        spread=None if result.spread is None else HeldSpread(result.spread, nominal, tuple(axes)),
        diagnostics=tuple(dict.fromkeys((*result.diagnostics, *rows))),
    )


def with_skill(
    result: Identified, validation: CrossValidation, errors: FoldErrors, where: str
) -> Identified:
    """The result with a warning for the axes on which it predicts no better than the mean motion.

    `where` says what was predicted.
    """
    poor = {
        validation.problem.nominal.dofs[k]: float(value)
        for k, value in zip(validation.axes, errors.nrmse, strict=True)
        if value >= 1.0
    }
    if not poor:
        return result
    named = ", ".join(f"{dof} {value:.2f}" for dof, value in poor.items())
    warning = (
        f"no skill: free runs of {where} are no better than the mean motion, whose NRMSE is 1, in "
        f"{named}"
    )
    rows = (Diagnostic(NO_SKILL, dof, value) for dof, value in poor.items())
    return replace(
        result, diagnostics=(*result.diagnostics, *rows), warnings=(*result.warnings, warning)
    )
