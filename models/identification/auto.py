"""The identifier that predicts best on blocks left out, and never one worse than no identifier.

Candidates are compared with the nominal model and with each other by free runs over blocks, or
files, of the training part (`cross_validation`). An axis on which a candidate is worse than the
nominal model, or on which neither beats the mean motion and the candidate is not better, keeps its
nominal equation; what is left must be better than the nominal model by more than one standard
error. Of the candidates that are not worse than the best one, the first is taken. It is identified
again on the whole training part; where it then fails, or no equation of its own is left, the next
one takes its place, and in the end the nominal model.

A candidate that is refined by free runs is estimated without that first (`quick`), as are its
alternatives. It is refined unless one before it has all of its terms and a quick estimate that is
as good. The `reserve` is tried only if no other candidate is admissible: its estimates are biased
by noise, which adds up over a long manoeuvre and hardly shows in half a minute, or seldom better.

What any protected identifier returns is held to the nominal model by the same rule, on the training
part itself (`identified`): this finds models that run away, not those that are fitted too closely.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from seatrial.models.diagnostics import DID_NOT_MOVE, WORSE_THAN_NOMINAL, Diagnostic
from seatrial.models.errors import ConfigurationError
from seatrial.models.identification.cross_validation import (
    UNUSABLE,
    BlockScore,
    CrossValidation,
    FoldErrors,
    choice,
    error_diagnostics,
    mixed_table,
    one_standard_error_rule,
    scores_of,
)
from seatrial.models.identification.physical_constraints import unphysical
from seatrial.models.identification.problem import (
    Force,
    Identified,
    Identifier,
    Needs,
    NoIdentifier,
    Problem,
    Spread,
    checked,
    with_interval,
)
from seatrial.models.ranges import Folds, Positive, check_ranges
from seatrial.models.recording.recording import Recording
from seatrial.models.vessel.basis import Term
from seatrial.models.vessel.table import Vessel

NONE = "none"
NO_SKILL = "no_skill"


@dataclass(frozen=True)
class Auto(Identifier):
    """Selection among several identifiers, those to be preferred first, and none."""

    candidates: dict[str, Identifier]
    folds: Folds
    horizon_s: Positive | None
    force: Force | None
    reserve: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_ranges(self)
        if not self.candidates:
            raise ConfigurationError("candidates: got none, expected at least one identifier")

    def needs(self) -> Needs:
        """The force of the simulation."""
        return Needs(self.force, thruster_lag=self.force == "filtered")

    def identify(self, problem: Problem, rng: np.random.Generator) -> Identified:
        """Identify with the candidate that predicts the blocks left out best."""
        blocks = CrossValidation(problem, self.folds, self.horizon_s, self.force)
        if not blocks.axes:
            return _fallback(problem, "no velocity moved by more than its noise")
        reasons, scores, tried = dict[str, str](), dict[str, BlockScore](), dict[str, Identifier]()
        quick, chosen, found = list[tuple[float, set[Term]]](), NONE, None
        for late in (False, True):
            for name in (name for name in self.candidates if (name in self.reserve) == late):
                candidate = self.candidates[name]
                alternatives = candidate.alternatives(problem) or {"": candidate}
                named = {name + variant: one for variant, one in alternatives.items()}
                best, score = _best(named, blocks, reasons, quick)
                if score is None:
                    continue
                if reason := _refusal(score, blocks):
                    reasons[best] = reason
                else:
                    scores[best], tried[best] = score, named[best]
            chosen, found = _first_that_holds(scores, tried, blocks, reasons, rng)
            if found is not None:
                break
        if found is None:
            found = _fallback(problem, "no candidate predicts the blocks left out better")
        errors = {NONE: blocks.nominal, **{name: score.errors for name, score in scores.items()}}
        refused = (f"{name}: {reason}" for name, reason in reasons.items())
        found = replace(
            found,
            diagnostics=(
                *found.diagnostics, *error_diagnostics(errors, blocks, chosen),
                *(Diagnostic("left_out", "all", 1.0, label=why) for why in refused),
            ),
            notes=(*found.notes, choice(chosen, errors[chosen], blocks)),
            fold_models=scores[chosen].models if chosen in scores else (),
        )  # fmt: skip
        return with_skill(found, blocks, errors[chosen], "the blocks left out")


def _best(
    named: Mapping[str, Identifier], blocks: CrossValidation, reasons: dict[str, str],
    refined: list[tuple[float, set[Term]]],
) -> tuple[str, BlockScore | None]:  # fmt: skip
    """The alternative with the best quick estimate, and its score; None if it cannot win.

    `refined` are errors of quick estimates that were refined, and their terms; its own are added.
    """
    quick = {name: one.quick() for name, one in named.items()}
    scores = scores_of(quick, blocks, reasons)
    if not scores:
        return next(iter(named)), None
    errors = {name: score.errors for name, score in scores.items()}
    best = one_standard_error_rule(errors)
    shown = {n: f"quick estimate: NRMSE {np.sqrt(own.error):.3g}" for n, own in errors.items()}
    reasons.update((name, reason) for name, reason in shown.items() if name != best)
    identifier, error = named[best], errors[best].error
    if identifier == quick[best]:
        return best, scores[best]
    terms = {*scores[best].models[0].terms}
    if any(error >= other and terms <= known for other, known in refined):
        reasons[best] = f"{shown[best]}, no better than that of another"
        return best, None
    refined.append((error, terms))
    return best, scores_of({best: identifier}, blocks, reasons).get(best)


def _refusal(score: BlockScore, blocks: CrossValidation) -> str | None:
    """Why a candidate is not admissible beside the nominal model; None: it is."""
    nominal, dofs = blocks.nominal, blocks.problem.nominal.dofs
    if not set(blocks.axes) - set(score.nominal_axes):
        return "on no axis better than the nominal model and the mean motion"
    if nominal.worse(score.errors):
        return None
    own, other = np.sqrt([score.errors.error, nominal.error])
    kept = ", ".join(dofs[k] for k in score.nominal_axes)
    return f"no better than the nominal model, beyond chance: NRMSE {own:.3g} and {other:.3g}" + (
        f", with its equations of {kept}" if kept else ""
    )


def _first_that_holds(
    scores: Mapping[str, BlockScore], candidates: Mapping[str, Identifier], blocks: CrossValidation,
    reasons: dict[str, str], rng: np.random.Generator,
) -> tuple[str, Identified | None]:  # fmt: skip
    """Name and result of the best candidate that holds on the whole training part too."""
    problem, left = blocks.problem, {name: score.errors for name, score in scores.items()}
    still = [k for k in range(len(problem.nominal.dofs)) if k not in blocks.axes]
    while left:
        name = one_standard_error_rule(left)
        left.pop(name)
        try:
            result = identified(candidates[name], problem, rng)
        except UNUSABLE as error:
            reasons[name] = f"on the whole training part: {error}"
            continue
        result = with_nominal_axes(result, problem.nominal, still, DID_NOT_MOVE)
        result = held_to_nominal(result, scores[name], problem)
        if np.any(result.residual.theta) or result.model.devices != problem.nominal.devices:
            return name, with_interval(candidates[name], result)
        reasons[name] = "on the whole training part: no equation of its own is left"
    return NONE, None


def _fallback(problem: Problem, reason: str) -> Identified:
    """The nominal model, with the reason."""
    nominal = NoIdentifier().identify(problem, np.random.default_rng(0))
    return replace(nominal, diagnostics=(Diagnostic("fallback", "all", 1.0, label=reason),))


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
        return mixed_table(self.spread.draw(result, rng, share, kappa2), self.nominal, self.axes)


def identified(identifier: Identifier, problem: Problem, rng: np.random.Generator) -> Identified:
    """What an identifier finds, protected if it asks for that, with what is to be said of it.

    Raises IdentificationError when there is none, PartError if a user's returns no model.
    """
    result = checked(identifier, identifier.identify(problem, rng), problem.nominal)
    if not identifier.protected:
        return result
    whole = WholeTraining(problem)
    if not whole.axes:
        return result
    score = whole.score([result.model], together=result.state_space is not None)
    result = held_to_nominal(result, score, problem)
    return with_skill(result, whole, score.errors, "the training part")


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
    kept, errors = np.isin(range(len(nominal.dofs)), axes), result.std_error
    residual = replace(result.residual, theta=np.where(kept, 0.0, result.residual.theta))
    rows = [Diagnostic(diagnostic, nominal.dofs[k], 1.0) for k in axes]
    return replace(
        result, model=nominal + residual, residual=residual,
        std_error=None if errors is None else np.where(kept, np.nan, errors),
        control_model=None, device_errors={},
        spread=None if result.spread is None else HeldSpread(result.spread, nominal, tuple(axes)),
        diagnostics=tuple(dict.fromkeys((*result.diagnostics, *rows))),
    )  # fmt: skip


def with_skill(
    result: Identified, validation: CrossValidation, errors: FoldErrors, where: str
) -> Identified:
    """The result with a warning for the axes on which it predicts no better than the mean motion.

    `where` says what was predicted.
    """
    dofs = [validation.problem.nominal.dofs[k] for k in validation.axes]
    poor = {d: float(v) for d, v in zip(dofs, errors.nrmse, strict=True) if v >= 1.0}
    if not poor:
        return result
    named = ", ".join(f"{dof} {value:.2f}" for dof, value in poor.items())
    than = "no better than the mean motion, whose NRMSE is 1"
    warning = f"no skill: free runs of {where} are {than}, in {named}"
    rows = (Diagnostic(NO_SKILL, dof, value) for dof, value in poor.items())
    warnings = (*result.warnings, warning)
    return replace(result, diagnostics=(*result.diagnostics, *rows), warnings=warnings)
