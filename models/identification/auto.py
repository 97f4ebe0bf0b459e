"""Model selection on the training part: cross-validated free-run error, one-standard-error rule.

Jervan (2020), chapter 6, asks for it: an order or a method chosen on the test part is evaluated on
the same data that it was chosen with. Here every candidate is identified on part of the training
half and simulated on the block left out, under the recorded force, starting at the measured state
every `horizon_s`. The error of a block is

    E = mean over dof of  rms(nu_simulated - nu) / std(nu of the training part)

A block on which a candidate cannot be identified, or its simulation diverges, has E = 1, the error
of predicting the mean motion. The candidates are listed from the simplest on; the first one whose
mean error exceeds the least by no more than one standard error is chosen: Hastie, Tibshirani and
Friedman (2009), section 7.10. The standard error is that of the difference over the blocks, since
the blocks are the same for all candidates. The chosen candidate is identified again on the whole
training part.
"""

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from annotated_types import Ge

from seatrial.models.demand import Demand, Extent, amount
from seatrial.models.errors import ConfigurationError, IdentificationError
from seatrial.models.findings import Finding
from seatrial.models.identification.problem import (
    FEWEST,
    Identified,
    Identifier,
    Needs,
    Problem,
    check_force,
    with_interval,
)
from seatrial.models.identification.validation import prediction
from seatrial.models.ranges import Positive, check_ranges
from seatrial.models.recording.recording import Recording, blocked_k_fold
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag

LOST = 1.0  # error of a block on which a candidate fails


@dataclass(frozen=True)
class Auto(Identifier):
    """Selection of one of several identifiers by cross-validation.

    `candidates` maps names to identifiers, the simplest first. `folds` is the number of blocks.
    `horizon_s` [s] is the length of a free run before it starts again at the measured state.
    `force` is the force of the simulation, as for `ls`.
    """

    candidates: dict[str, Identifier]
    folds: Annotated[int, Ge(2)]
    horizon_s: Positive
    force: str | None

    def __post_init__(self) -> None:
        check_ranges(self)
        if not self.candidates:
            raise ConfigurationError("candidates: got none, expected at least one identifier")
        check_force(self.force)

    def check(self, nominal: Vessel, thruster: SecondOrderLag | None, measured: bool) -> None:
        """Raise ConfigurationError if the check of a candidate does."""
        for name, candidate in self.candidates.items():
            try:
                candidate.check(nominal, thruster, measured)
            except ConfigurationError as error:
                raise ConfigurationError(f"identifier.candidates.{name}: {error}") from error

    def needs(self) -> Needs:
        """The force of the simulation."""
        return Needs(self.force, thruster_lag=self.force == "filtered", samples=FEWEST * self.folds)

    def demands(self, extent: Extent) -> list[Demand]:
        """Every candidate on every fold, and the one that is chosen."""
        read = float(self.folds) * len(self.candidates) * extent.samples
        detail = f"{amount(self.folds)} fits of {len(self.candidates)} candidates"
        demands = [Demand("folds", self.folds, detail, read)]
        for name, candidate in self.candidates.items():
            each = [(candidate.without_bootstrap(), self.folds), (candidate, 1)]
            demands += [
                demand.of(f"candidates.{name}", times)
                for identifier, times in each
                for demand in identifier.demands(extent)
            ]
        return demands

    def identify(self, problem: Problem, rng: np.random.Generator) -> Identified:
        """Identify with the candidate that cross-validation chooses.

        Raises IdentificationError when no candidate predicts better than the mean motion.
        """
        seeds = rng.integers(2**63, size=len(self.candidates))
        errors = {
            name: self._errors(candidate, problem, int(seed))
            for (name, candidate), seed in zip(self.candidates.items(), seeds, strict=True)
        }
        chosen = one_standard_error(errors)
        candidate = self.candidates[chosen]
        result = with_interval(candidate, candidate.identify(problem, rng))
        return replace(result, findings=(*result.findings, *_findings(errors, chosen)))

    def _errors(self, candidate: Identifier, problem: Problem, seed: int) -> Array:
        """Free-run error on each block left out, shape (folds,); LOST where a candidate fails."""
        training = problem.training
        scale = np.std(training.nu, axis=0)
        quick = candidate.without_bootstrap()
        errors = np.full(self.folds, LOST)
        for i, split in enumerate(blocked_k_fold(len(training), self.folds)):
            part = training.part(split.train)
            try:
                model = quick.identify(
                    replace(problem, training=part, validation=part), np.random.default_rng(seed)
                ).model
                block = training.part(split.test)
                errors[i] = self._free_run(model, block, problem.thruster, scale)
            except IdentificationError:
                continue
        return errors

    def _free_run(
        self, model: Vessel, block: Recording, thruster: SecondOrderLag | None, scale: Array
    ) -> float:
        horizon = max(round(self.horizon_s / block.period_s), 2)
        ahead = prediction(model, block, thruster, self.force, horizon).ahead(None)
        return LOST if ahead.diverged else float(np.mean(ahead.rmse[len(scale) :] / scale))


def one_standard_error(errors: dict[str, Array]) -> str:
    """The first name whose error exceeds the least by at most one standard error.

    `errors` maps names to errors (folds,). Raises IdentificationError when no candidate predicts
    better than the mean motion.
    """
    best = min(errors, key=lambda name: float(np.mean(errors[name])))
    if np.mean(errors[best]) >= LOST:
        raise IdentificationError(
            f"no candidate predicts the blocks left out better than their mean: {', '.join(errors)}"
        )

    def within(name: str) -> bool:
        excess = errors[name] - errors[best]
        return bool(np.mean(excess) <= np.std(excess, ddof=1) / np.sqrt(len(excess)))

    return next(name for name in errors if within(name))


def _findings(errors: dict[str, Array], chosen: str) -> tuple[Finding, ...]:
    """Error of every candidate on every block (i candidate, j block), and the choice."""
    rows = []
    for i, (name, values) in enumerate(errors.items()):
        for j, value in enumerate(values):
            rows.append(Finding("auto_error", "all", float(value), "", i, j, name))
        rows.append(Finding("auto_chosen", "all", float(name == chosen), "", i, label=name))
    return tuple(rows)
