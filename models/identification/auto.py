"""The identifier that predicts best on blocks left out, and never one worse than no identifier.

Candidates are compared with the nominal model and with each other by free runs over blocks of the
training part (`blocked_free_run`). A candidate is admissible if it is worse than the nominal model
in no degree of freedom, and better on the whole by more than one standard error: otherwise chance
may have chosen it. The one chosen is identified again on the whole training part; where it then
fails, or predicts that part worse than the nominal model, the next one takes its place, and in the
end the nominal model. A degree of freedom that did not move keeps its nominal equation.

An estimate that noise biases (without `interval_covers`) is chosen only where it predicts
significantly better: its bias adds up over a long manoeuvre, such as a turning circle, and free
runs of half a minute hardly show it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError
from seatrial.models.identification.blocked_free_run import (
    UNUSABLE,
    WORSE_THAN_NOMINAL,
    Blocks,
    Contest,
    LeftOut,
    error_diagnostics,
    first_within,
    with_nominal_axes,
)
from seatrial.models.identification.problem import (
    Identified,
    Identifier,
    Needs,
    NoIdentifier,
    Problem,
    check_force,
    with_interval,
)
from seatrial.models.identification.validation import prediction
from seatrial.models.ranges import Folds, Positive, check_ranges
from seatrial.models.vessel.table import Vessel

NONE = "none"
MIN_STANDARD_ERRORS = 2.0  # standard errors


@dataclass(frozen=True)
class Auto(Identifier):
    """Selection among several identifiers and none.

    `candidates` maps names to identifiers, those to be preferred first; of the alternatives of one
    of them (`tune`) the best competes. `folds` is the number of blocks and `horizon_s` [s] the
    length of a free run, under the `force` of the simulation, as for `ls`. After `budget_s` [s] no
    further candidate is tried (null: no limit); the result then depends on the machine's speed.
    """

    candidates: dict[str, Identifier]
    folds: Folds
    horizon_s: Positive
    force: str | None
    budget_s: Positive | None

    def __post_init__(self) -> None:
        check_ranges(self)
        if not self.candidates:
            raise ConfigurationError("candidates: got none, expected at least one identifier")
        check_force(self.force)

    def needs(self) -> Needs:
        """The force of the simulation."""
        return Needs(self.force, thruster_lag=self.force == "filtered")

    def identify(self, problem: Problem, rng: np.random.Generator) -> Identified:
        """Identify with the candidate that predicts the blocks left out best."""
        blocks = Blocks(problem, self.folds, self.horizon_s, self.force)
        if not blocks.axes:
            return _fallback(problem, "no velocity moved by more than its noise")
        try:
            reference = blocks.judge(NoIdentifier())
        except UNUSABLE:  # the nominal model diverges: what does not is better
            reference = None
        candidates = {
            name: {
                name + variant: alternative
                for variant, alternative in candidate.alternatives(problem).items()
            }
            or {name: candidate}
            for name, candidate in self.candidates.items()
        }
        alternatives = {n: a for named in candidates.values() for n, a in named.items()}
        contest = Contest(candidates, blocks, reference, self.budget_s)
        errors, reasons = contest.run()
        chosen, identified = self._best(alternatives, blocks, dict(errors), reasons, rng)
        known = {} if reference is None else {NONE: reference}
        judged = {**known, **errors}
        diagnostics = error_diagnostics(judged, blocks, chosen)
        left_out = [
            Diagnostic("left_out", "all", 1.0, label=f"{n}: {r}") for n, r in reasons.items()
        ]
        models = judged[chosen].models if chosen in judged else ()
        diagnostics = (*identified.diagnostics, *diagnostics, *left_out)
        return replace(identified, diagnostics=diagnostics, fold_models=models)

    def _best(
        self,
        alternatives: Mapping[str, Identifier],
        blocks: Blocks,
        errors: dict[str, LeftOut],
        reasons: dict[str, str],
        rng: np.random.Generator,
    ) -> tuple[str, Identified]:
        """Name and result of the best alternative that holds on the whole training part too.

        One that keeps a nominal equation there gives way to one that is not significantly worse.
        """
        held: tuple[str, Identified] | None = None
        least = min(errors.values(), key=lambda one: one.error, default=None)
        while errors:
            name = preferred(errors, alternatives)
            left_out = errors.pop(name)
            if held and least and left_out.exceeds(least, MIN_STANDARD_ERRORS):
                continue
            try:
                result = alternatives[name].identify(blocks.problem, rng)
                result = moving_axes_only(result, blocks)
                reason = _objection(result.model, blocks)
            except UNUSABLE as error:
                reason = str(error)
            if reason is None:
                found = name, with_interval(alternatives[name], result)
                if not any(
                    diagnostic.name == WORSE_THAN_NOMINAL for diagnostic in result.diagnostics
                ):
                    return found
                held, reason = held or found, "it keeps the nominal equation of an axis"
            reasons[name] = f"on the whole training part: {reason}"
        if held:
            reasons.pop(held[0])
            return held
        return NONE, _fallback(blocks.problem, "no candidate predicts the blocks left out better")


def preferred(errors: dict[str, LeftOut], alternatives: Mapping[str, Identifier]) -> str:
    """The first name whose error hardly exceeds the least one, or one that noise does not bias.

    The latter may exceed the least error by SIGNIFICANT standard errors.
    """
    name = first_within(errors)
    unbiased = {n: e for n, e in errors.items() if alternatives[n].interval_covers}
    if name in unbiased or not unbiased:
        return name
    best = min(errors.values(), key=lambda one: one.error)
    other = first_within(unbiased)
    return name if unbiased[other].exceeds(best, MIN_STANDARD_ERRORS) else other


def _objection(model: Vessel, blocks: Blocks) -> str | None:
    """Why a model is worse than the nominal one on the training part; None: it is not."""
    problem = blocks.problem
    if (
        prediction(model, problem.training, problem.thruster, blocks.force)
        .over("free_run")
        .diverged
    ):
        return "its free run diverges"
    run = blocks.runs(model, blocks.smoothed)
    try:
        reference = blocks.runs(problem.nominal, blocks.smoothed)
    except UNUSABLE:
        return None
    return blocks.worse(run, reference)


def moving_axes_only(result: Identified, blocks: Blocks) -> Identified:
    """The result with the nominal equations of the degrees of freedom that did not move."""
    nominal = blocks.problem.nominal
    still = [k for k in range(len(nominal.dofs)) if k not in blocks.axes]
    return with_nominal_axes(result, nominal, still, "did_not_move")


def _fallback(problem: Problem, reason: str) -> Identified:
    """The nominal model, with the reason."""
    nominal = NoIdentifier().identify(problem, np.random.default_rng(0))
    return replace(nominal, diagnostics=(Diagnostic("fallback", "all", 1.0, label=reason),))
