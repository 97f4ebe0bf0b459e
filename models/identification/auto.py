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
as good; how much refinement gains by further terms a quick estimate does not show.

The `reserve` is tried only if no other candidate is admissible: its estimates are biased by noise,
or seldom better. Its bias adds up over a long manoeuvre, such as a turning circle, and free runs
of half a minute hardly show it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError
from seatrial.models.identification.cross_validation import (
    UNUSABLE,
    BlockScore,
    CrossValidation,
    FoldErrors,
    error_diagnostics,
    one_standard_error_rule,
    scores_of,
)
from seatrial.models.identification.fallback import (
    held_to_nominal,
    identified,
    with_nominal_axes,
    with_skill,
)
from seatrial.models.identification.problem import (
    Force,
    Identified,
    Identifier,
    Needs,
    NoIdentifier,
    Problem,
    with_interval,
)
from seatrial.models.ranges import Folds, Positive, check_ranges
from seatrial.models.vessel.basis import Term

NONE = "none"


@dataclass(frozen=True)
class Auto(Identifier):
    """Selection among several identifiers and none.

    `candidates` maps names to identifiers, those to be preferred first, `reserve` names those of
    them that are tried last; of the alternatives of one of them (`tune`) the best competes. `folds`
    is the number of blocks and `horizon_s` [s] the length of a free run (null: by how fast errors
    grow), under the `force` of the simulation, as for `ls`.
    """

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
        quick = list[tuple[float, set[Term]]]()
        first = {n: c for n, c in self.candidates.items() if n not in self.reserve}
        last = {n: c for n, c in self.candidates.items() if n in self.reserve}
        chosen, found = NONE, None
        for group in (first, last):
            for name, candidate in group.items():
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
            reason = "no candidate predicts the blocks left out better"
            found = _fallback(problem, reason)
        errors = {NONE: blocks.nominal, **{name: score.errors for name, score in scores.items()}}
        rows = error_diagnostics(errors, blocks, chosen)
        rows += tuple(
            Diagnostic("left_out", "all", 1.0, label=f"{name}: {reason}")
            for name, reason in reasons.items()
        )
        found = replace(
            found,
            diagnostics=(*found.diagnostics, *rows),
            notes=(*found.notes, _account(chosen, errors, found, blocks)),
            fold_models=scores[chosen].models if chosen in scores else (),
        )
        return with_skill(found, blocks, errors[chosen], "the blocks left out")


def _best(
    named: Mapping[str, Identifier], blocks: CrossValidation, reasons: dict[str, str],
    refined: list[tuple[float, set[Term]]],
) -> tuple[str, BlockScore | None]:  # fmt: skip
    """The alternative with the best quick estimate, and its score; None if it cannot win.

    `refined` are the errors of the quick estimates of candidates that were refined before, and
    their terms; its own are added.
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
        result = with_nominal_axes(result, problem.nominal, still, "did_not_move")
        result = held_to_nominal(result, scores[name], problem)
        if np.any(result.residual.theta) or result.model.devices != problem.nominal.devices:
            return name, with_interval(candidates[name], result)
        reasons[name] = "on the whole training part: no equation of its own is left"
    return NONE, None


def _account(
    chosen: str, errors: Mapping[str, FoldErrors], found: Identified, blocks: CrossValidation
) -> str:
    """One line: the choice, its errors beside those of none, and the axes that are nominal."""
    dofs = blocks.problem.nominal.dofs
    own = ", ".join(
        f"{dofs[k]} {value:.2f} ({other:.2f})"
        for k, value, other in zip(
            blocks.axes, errors[chosen].nrmse, errors[NONE].nrmse, strict=True
        )
    )
    kept = [
        dof for dof in dofs
        if chosen != NONE and not np.any(found.residual.theta[:, dofs.index(dof)])
    ]  # fmt: skip
    nominal = f"; nominal equations: {', '.join(kept)}" if kept else ""
    return (
        f"auto: {chosen}; NRMSE of blocks left out (of the nominal model; 1 is the mean motion): "
        f"{own}{nominal}"
    )


def _fallback(problem: Problem, reason: str) -> Identified:
    """The nominal model, with the reason."""
    nominal = NoIdentifier().identify(problem, np.random.default_rng(0))
    return replace(nominal, diagnostics=(Diagnostic("fallback", "all", 1.0, label=reason),))
