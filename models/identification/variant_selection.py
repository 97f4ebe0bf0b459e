"""The variant of a subspace identification, and whether it has a direct term, from the data.

Each alternative is identified without one block at a time, and judged on that block. What it is
judged by depends on whether the input depends on past outputs.

Without such feedback all alternatives are consistent, and the simulation decides, from the state
that fits the block best: predictions would use past outputs, which hide a wrong response.

With feedback the input contains past noise. `open` is biased then, and because of that noise it
simulates the record better than the truth does. The one-step prediction error has no such
preference if the noise is modelled: Ljung (1999), System Identification, section 13.4.

Test for feedback: without it the innovations e are independent of all inputs. u_k is regressed on
J past samples of u, and of e beside them; an F-test compares the two. Caines and Chan (1975),
Feedback between stationary stochastic processes, IEEE Transactions on Automatic Control 20.

The error of a block is the mean square of predicted - measured over its variance, the mean over the
outputs, at most that of the mean; the choice is that of `cross_validation`.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
import scipy

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import IdentificationError
from seatrial.models.identification.cross_validation import FoldErrors, one_standard_error_rule
from seatrial.models.identification.subspace import (
    NOISE_FREE,
    Record,
    Variant,
    Window,
    compressed,
    explained_by_past,
    identify_innovations,
)
from seatrial.models.recording.recording import blocked_k_fold
from seatrial.models.simulation.statespace import StateSpace
from seatrial.models.vessel.basis import Array, Codes

VARIANT_FOLDS = 5
MAX_SAMPLES = 20_000  # samples that the choice is made with: the first ones of a longer record
FEEDBACK_P = 1e-3  # p-value below which there is feedback
Alternative = tuple[Variant, bool]  # and whether D is estimated
NAMES: dict[Alternative, str] = {
    ("closed", False): "closed",
    ("open", False): "open",
    ("open", True): "open with D",
}


@dataclass(frozen=True, eq=False)
class VariantChoice:
    """The chosen alternative, the p-value of no feedback, and the errors of all alternatives."""

    alternative: Alternative
    p_value: float
    errors: dict[str, FoldErrors]  # a run for each block left out

    def diagnostics(self) -> list[Diagnostic]:
        """The choice, the test for feedback, and the NRMSE of each alternative on each block j."""
        feedback = self.p_value < FEEDBACK_P
        reason = "judged by " + ("one-step predictions" if feedback else "simulations")
        variant, direct = self.alternative
        chosen = NAMES[self.alternative]
        rows = [
            Diagnostic("variant", "all", float(variant == "closed"), label=chosen),
            Diagnostic("feedthrough", "all", float(direct)),
            Diagnostic("feedback", "all", float(feedback), label=reason),
            Diagnostic("feedback_p_value", "all", self.p_value),
        ]
        for i, (name, left_out) in enumerate(self.errors.items()):
            rows += [
                Diagnostic("variant_error", "all", float(error), "", i, j, name)
                for j, error in enumerate(np.sqrt(np.mean(left_out.squares, axis=1)))
            ]
        return rows


def select_variant(
    y: Array,
    u: Array,
    L: int,
    J: int,
    order: int | None,
    alternatives: Sequence[Alternative] = tuple(NAMES),
    *,
    stable: bool = False,
    stretch: Codes | None = None,
    file: Codes | None = None,
) -> VariantChoice:
    """Choose one of the alternatives, the simplest first, for outputs y (N, m), inputs u (N, r).

    At most MAX_SAMPLES are used. Where `file` (N,) numbers several files, these are the blocks.
    The other arguments are those of `identify_innovations`. Raises IdentificationError when the
    data are too few for the test of feedback.
    """
    y, u = y[:MAX_SAMPLES], u[:MAX_SAMPLES]
    parts = np.zeros(len(y), dtype=np.int64) if stretch is None else stretch[:MAX_SAMPLES]
    record = Record(y, u, parts, np.arange(len(y)))
    p_value = feedback_p_value(record, J)
    splits = blocked_k_fold(
        len(y), VARIANT_FOLDS, file=None if file is None else file[:MAX_SAMPLES]
    )
    samples = np.array([float(np.count_nonzero(test)) for _, test in splits])
    errors = {NAMES[one]: np.ones((len(splits), y.shape[1])) for one in alternatives}
    for i, (train, test) in enumerate(splits):
        number = 2 * parts + (np.cumsum(test) > 0)  # no window may bridge the block left out
        for variant, direct in alternatives:
            with suppress(IdentificationError):
                model = identify_innovations(
                    y[train], u[train], L, J, order, variant, feedthrough=direct, stable=stable,
                    stretch=number[train],
                ).model  # fmt: skip
                left_out = Record(y[test], u[test], parts[test], record.times[test])
                error = relative_squares(model, left_out, p_value >= FEEDBACK_P)
                errors[NAMES[variant, direct]][i] = np.fmin(error, 1.0)  # that of the mean
    found = {name: FoldErrors(squares, samples) for name, squares in errors.items()}
    best = one_standard_error_rule(found)
    chosen = next(one for one in alternatives if NAMES[one] == best)
    return VariantChoice(chosen, p_value, found)


def feedback_p_value(record: Record, J: int) -> float:
    """The p-value of the hypothesis that no input depends on past outputs; 1 without noise.

    The least p-value of the inputs, times their number (Bonferroni).
    """
    scales = [np.where((size := np.std(x, axis=0)) > 0.0, size, 1.0) for x in record[:2]]
    record = record._replace(y=record.y / scales[0], u=record.u / scales[1])
    after, e = explained_by_past(record, J, False)
    noisy = np.std(e.y, axis=0) > NOISE_FREE
    rows = after.starts(J + 1)
    blocks = [Window(after.u, 0, J), Window(e.y[:, noisy], 0, J), Window(after.u, J, 1)]
    a, b, r = (window.width for window in blocks)
    left = len(rows) - a - b
    if b == 0 or left < 1:
        return 1.0
    R = compressed(blocks, rows, 1)[:, -r:]
    explained, rest = np.sum(R[a : a + b] ** 2, axis=0), np.sum(R[a + b :] ** 2, axis=0)
    random = rest > NOISE_FREE**2 * np.sum(R**2, axis=0)  # not a function of its own past
    ratio = explained[random] / b / (rest[random] / left)
    return float(min(1.0, r * np.min(scipy.stats.f.sf(ratio, b, left), initial=1.0)))


def relative_squares(model: StateSpace, record: Record, simulated: bool) -> Array:
    """Mean square error of each output over its variance (m,), of one step or a simulation.

    NaN where the simulation diverges, zero for an output that does not vary.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        predicted = [
            model.simulate(u, model.initial_state(y, u, free_run=True))
            if simulated
            else model.predict(y, u, 1, model.initial_state(y, u))
            for y, u in record.parts()
        ]
        square = np.mean((np.vstack(predicted) - record.y) ** 2, axis=0)
    variance = np.var(record.y, axis=0)
    ratio = np.divide(square, variance, out=np.zeros_like(square), where=variance > 0.0)
    return np.asarray(ratio)
