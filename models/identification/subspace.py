"""Deterministic and stochastic subspace identification (DSR) on innovations form.

    x_{k+1} = A x_k + B u_k + K e_k        y_k = C x_k + D u_k + e_k

The rows of the block Hankel matrices are windows in time: the transpose of the literature's. With J
past samples as instruments they are compressed by one QR factorisation. An SVD of the part of the L
future samples explained by the past gives the extended observability matrix. Its shift invariance
gives A, and its first block is C. The other matrices follow from linear least squares.

`open`: the future inputs are projected out, and the past samples as instruments remove the noise.
With feedback the future inputs contain past noise, and the model is biased for any record length.

`closed` (dsr_e): first the innovations e_k = y_k - y_k/[u past, y past] are estimated from J past
samples, which is valid under feedback; then, with e known, a deterministic problem is solved with
the inputs (u, e) and the output y - e.

Di Ruscio (2009), "A bootstrap subspace identification method", Modeling, Identification and
Control 30; as used by Bargouth (2022), section 3.7, who writes D for C and E for D.

The predictor x_{k+1} = (A - K C) x_k + B u_k + K y_k forgets its first state if A - K C is stable.
If the K of a regression does not make it so, the Riccati equation of the predictor is solved with
the covariances of the same noise; its stabilising solution has the same spectrum.
Anderson and Moore (1979), Optimal Filtering, chapters 4 and 9.
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
import scipy

from seatrial.models.compiled import kernel
from seatrial.models.errors import IdentificationError
from seatrial.models.identification.cross_validation import (
    FOLDS,
    FoldErrors,
    one_standard_error_rule,
)
from seatrial.models.identification.least_squares import triangle
from seatrial.models.identification.residual import turns
from seatrial.models.recording.recording import blocked_k_fold
from seatrial.models.simulation.statespace import StateSpace, spectral_radius
from seatrial.models.vessel.basis import Array, Codes

Variant = Literal["open", "closed"]
FLOORS = (1e-9, 1e-6, 1e-3, 1.0)  # process noise added to all states, relative to the mean of Q
DETERMINED = 1e-11  # least ratio of smallest to largest singular value of a regression
EXCITED = 1e-11  # the same of the inputs' Hankel matrix
NOISE_FREE = 1e-9  # innovations below this fraction of the output are rounding
ORDER_FLOOR = 1e-10  # singular values below this fraction of the largest are rounding
MAX_SAMPLES = 20_000  # samples that the variant is chosen with: the first ones of a longer record
FEEDBACK_P = 1e-3  # p-value below which there is feedback
Alternative = tuple[Variant, bool]  # and whether D is estimated
NAMES: dict[Alternative, str] = {
    ("closed", False): "closed",
    ("open", False): "open",
    ("open", True): "open with D",
}


class Record(NamedTuple):
    """Normalised data; `stretch` numbers the contiguous parts, `times` are the samples used."""

    y: Array  # (N, m)
    u: Array  # (N, r)
    stretch: Codes  # (N,), not decreasing
    times: Codes  # first samples of the windows used, with repetitions for a bootstrap

    def parts(self) -> list[tuple[Array, Array]]:
        """Outputs and inputs of each contiguous part."""
        edges = np.flatnonzero(np.diff(self.stretch)) + 1
        return list(zip(np.split(self.y, edges), np.split(self.u, edges), strict=True))

    def starts(self, length: int) -> Codes:
        """First samples of the windows of `length` samples that lie within one stretch."""
        n = len(self.y) - length + 1
        contiguous = self.stretch[length - 1 :] == self.stretch[: max(n, 0)]
        times = self.times[self.times < n]
        return np.asarray(times[contiguous[times]])


class Window(NamedTuple):
    """A block of the Hankel matrix: x_{k+first} ... x_{k+first+length-1} for a window at k."""

    x: Array  # (N, m)
    first: int
    length: int

    @property
    def width(self) -> int:
        """Columns of the block."""
        return self.length * int(self.x.shape[1])


def hankel(blocks: list[Window], rows: Codes) -> Array:
    """Transposed block Hankel matrices, side by side, of the windows that start at `rows`."""
    return np.hstack([
        block.x[rows[:, None] + np.arange(block.first, block.first + block.length)].reshape(
            len(rows), block.width
        )
        for block in blocks
    ])  # fmt: skip


def compressed(blocks: list[Window], rows: Codes, fewest: int) -> Array:
    """R of the Hankel matrices, of which only some rows are in memory at a time.

    Raises IdentificationError for fewer windows than the `fewest`.
    """
    if len(rows) < fewest:
        raise IdentificationError(
            f"got {len(rows)} windows of data, expected at least {fewest}: "
            f"use a longer recording, a shorter period, or smaller L and J"
        )
    return triangle(hankel(blocks, rows[turn]) for turn in turns(len(rows)))


def projected(known: list[Window], ahead: Window, rows: Codes) -> Array:
    """Lower triangular factor, transposed R, of known inputs and outputs ahead.

    Raises IdentificationError when the inputs, the first window, are not persistently exciting.
    """
    blocks, inputs = [*known, ahead], known[0].width
    R = compressed(blocks, rows, sum(block.width for block in blocks)).T
    excitation = np.linalg.svd(R[:inputs, :inputs], compute_uv=False)
    if excitation[-1] < EXCITED * excitation[0]:
        raise IdentificationError(
            f"the inputs do not excite all {inputs} directions of L samples: got a singular value "
            f"ratio of {excitation[-1] / excitation[0]:.1e}, expected at least {EXCITED:g}"
        )
    return np.asarray(R)


def explained_by_past(record: Record, J: int, feedthrough: bool) -> tuple[Record, Record]:
    """y_k - e_k and e_k, the least-squares prediction from J past samples and its error.

    The first J samples of every stretch are dropped. Raises IdentificationError for too few.
    """
    past = [Window(record.u, 0, J), Window(record.y, 0, J)]
    past += [Window(record.u, J, 1)] if feedthrough else []
    count = sum(window.width for window in past)
    R = compressed([*past, Window(record.y, J, 1)], record.starts(J + 1), count + 1)
    coefficients = np.linalg.lstsq(R[:, :count], R[:, count:], rcond=1e-12)[0]
    every = record._replace(times=np.arange(len(record.y))).starts(J + 1)
    parts = [hankel(past, every[turn]) @ coefficients for turn in turns(len(every))]
    explained, y = np.vstack(parts), record.y[every + J]
    position = np.full(len(record.y), -1)
    position[every + J] = np.arange(len(every))
    times = position[record.times]
    shorter = Record(explained, record.u[every + J], record.stretch[every + J], times[times >= 0])
    return shorter, shorter._replace(y=y - explained)


@dataclass(frozen=True, eq=False)
class Realisation:
    """An identified model and the singular values that its order was chosen from."""

    model: StateSpace
    singular_values: Array
    gain_recomputed: bool  # K of the regression had no stable predictor, or there was no noise
    poles_moved: int  # number of poles that were moved onto the unit circle


def identify_innovations(
    y: Array, u: Array, L: int, J: int, order: int | None, variant: Variant, *, feedthrough: bool =
    False, stable: bool = False, period_s: float = 1.0, stretch: Codes | None = None, times: Codes |
    None = None,
) -> Realisation:  # fmt: skip
    """Identify A, B, C, D, K, F and x0 from outputs y (N, m) and inputs u (N, r).

    `order` None chooses the largest gap of the singular values. `feedthrough` estimates D, which
    `closed` cannot. `stable` moves poles onto the unit circle that lie outside. `stretch` (N,) is
    the index of the contiguous part of each sample, `times` those of the samples to use (for a
    bootstrap), `period_s` [s] the sample time. Raises IdentificationError when there is no model.
    """
    if not (np.all(np.isfinite(y)) and np.all(np.isfinite(u))):
        raise IdentificationError("the data contain values that are not finite")
    y_scale, u_scale = np.std(y, axis=0), np.std(u, axis=0)
    for what, values, size in (("output", y, y_scale), ("input", u, u_scale)):
        for column in np.flatnonzero(~(size > 0.0)):
            got = f"got {values[0, column]:g}"
            raise IdentificationError(f"{what} {column + 1} does not vary: {got}")
    parts = np.zeros(len(y), dtype=np.int64) if stretch is None else stretch
    every = np.arange(len(y)) if times is None else times
    record = Record(y / y_scale, u / u_scale, parts, every)
    identify = _identify_closed if variant == "closed" else _identify_open
    realisation = identify(record, L, J, order, feedthrough, stable)
    model, pairs = realisation.model, record.parts()
    states = [model.initial_state(*pair) for pair in pairs]
    errors = [y - model.predict(y, u, 1, x0) for (y, u), x0 in zip(pairs, states, strict=True)]
    R = np.asarray(np.linalg.qr(np.vstack(errors), mode="r"), dtype=np.float64)
    model = replace(model, F=R.T / np.sqrt(len(y)), x0=states[0], period_s=period_s)
    return replace(realisation, model=model.scaled(u_scale, y_scale))


def _identify_open(
    record: Record, L: int, J: int, order: int | None, feedthrough: bool, stable: bool
) -> Realisation:
    """Project out the future inputs, with the past as instruments; B and D by output error."""
    inputs = Window(record.u, J, L + int(feedthrough))
    past = [Window(record.u, 0, J), Window(record.y, 0, J)]
    R = projected([inputs, *past], Window(record.y, J, L + 1), record.starts(J + L + 1))
    a, b = inputs.width, sum(window.width for window in (inputs, *past))
    A, C, values, moved = realise(R[b:, a:b], record.y.shape[1], order, stable)
    observer = observer_gain(A, C)
    forgets = not moved and spectral_radius(A) < 1.0
    gain = np.zeros_like(observer) if forgets else observer
    B, D = input_matrices(record, record.u, A, C, gain, feedthrough)
    model = StateSpace(A, B, C, D, 1.0)
    explained, e = explained_by_past(record, J, feedthrough)
    noise, scale = _innovation_inputs(e.y)
    K, _ = input_matrices(explained, noise, A, C, observer, False, known=model)
    model, recomputed = with_gain(model, K @ scale, e.y)
    return Realisation(model, values, recomputed, moved)


def _identify_closed(
    record: Record, L: int, J: int, order: int | None, _: bool, stable: bool
) -> Realisation:
    """Estimate the innovations, then solve a deterministic problem with the inputs (u, e)."""
    m, r = record.y.shape[1], record.u.shape[1]
    explained, e = explained_by_past(record, J, False)
    noise, scale = _innovation_inputs(e.y)
    known = [Window(explained.u, 0, L), Window(noise, 0, L)]
    R = projected(known, Window(explained.y, 0, L + 1), explained.starts(L + 1))
    a = sum(window.width for window in known)
    A, C, values, moved = realise(R[a:, a:], m, order, stable)
    v = np.hstack([explained.u, noise])
    BK, D = input_matrices(explained, v, A, C, observer_gain(A, C), False)
    model = StateSpace(A, BK[:, :r], C, D[:, :r], 1.0)
    model, recomputed = with_gain(model, BK[:, r:] @ scale, e.y)
    return Realisation(model, values, recomputed, moved)


def _innovation_inputs(e: Array) -> tuple[Array, Array]:
    """The innovations above rounding with unit rms, and the map (n_kept, m) that scales them."""
    size = np.sqrt(np.mean(e**2, axis=0))
    columns = np.flatnonzero(size > NOISE_FREE)
    return e[:, columns] / size[columns], np.eye(len(size))[columns] / size


def realise(Z: Array, m: int, order: int | None, stable: bool) -> tuple[Array, Array, Array, int]:
    """A, C, singular values and moved poles from the future that the state explains.

    Z_{J|L} = O_L X = U S V',  C = U_1,  A = U' Z_{J+1|L} V S^-1; U_1 and each block have m rows.
    """
    left, values, right = np.linalg.svd(Z[:-m], full_matrices=False)
    floored = np.maximum(values, ORDER_FLOOR * values[0])
    n = int(np.argmax(floored[:-1] / floored[1:])) + 1 if order is None else order
    O = left[:, :n]  # noqa: E741 - the literature's name
    A, moved = O.T @ Z[m:] @ right[:n].T / values[:n], 0
    if stable:
        A, moved = onto_unit_circle(A)
    return A, O[:m], values, moved


def onto_unit_circle(A: Array) -> tuple[Array, int]:
    """A with the poles outside the unit circle moved radially onto it, and their number.

    A = Q T Q' with Q orthogonal and T block triangular; the diagonal blocks have the poles, and
    only they change. Noferini and Poloni (2021), Nearest Omega-stable matrix via Riemannian
    optimization, Numerische Mathematik 148, project the Schur form in this way for given Q.
    """
    T, Q = scipy.linalg.schur(A)
    i = moved = 0
    while i < len(T):
        pair = i + 1 < len(T) and T[i + 1, i] != 0.0
        block = slice(i, i + 1 + int(pair))
        radius = spectral_radius(T[block, block])
        if radius > 1.0:
            T[block, block] /= radius
            moved += 1 + int(pair)
        i = block.stop
    return np.asarray(Q @ T @ Q.T), moved


def with_gain(model: StateSpace, K: Array, e: Array) -> tuple[StateSpace, bool]:
    """The model with gain K (n, m), or with the stable K of the same spectrum.

    If A - K C is not stable, the Riccati equation with the covariances K R K', K R and R gives the
    stable gain with the same noise spectrum; R is that of the innovations e (N, m). Data without
    noise do not determine K: then process noise at the inputs and measurement noise of 1 % of the
    output are assumed. Also returns whether the gain was recomputed. Raises IdentificationError if
    (A, C) is not detectable.
    """
    A, C, m = model.A, model.C, len(model.C)
    if not np.any(K):
        noise = model.B @ model.B.T, np.zeros((model.order, m)), 1e-4 * np.eye(m)
        return replace(model, K=observer_gain(A, C, noise)), True
    model = replace(model, K=K)
    if model.predictor_radius < 1.0:
        return model, False
    R = e.T @ e / len(e)
    R = R + 1e-6 * np.trace(R) / m * np.eye(m)
    try:
        stable = observer_gain(A, C, (K @ R @ K.T, K @ R, R))
    except IdentificationError:  # a K of hardly any data may be too large for the equation
        stable = observer_gain(A, C)
    return replace(model, K=stable), True


def observer_gain(A: Array, C: Array, noise: tuple[Array, Array, Array] | None = None) -> Array:
    """K = (A P C' + S)(C P C' + R)^-1 with P of the Riccati equation, so that A - K C is stable.

    `noise` are the covariances Q, S, R (None: I, 0, I). If they do not excite every state, process
    noise is added to all, in increasing amounts, until there is a stabilising solution.
    """
    Q, S, R = noise or (np.eye(len(A)), np.zeros((len(A), len(C))), np.eye(len(C)))
    size = max(float(np.trace(Q)) / len(A), float(np.finfo(np.float64).tiny))
    for share in FLOORS:
        try:
            P = scipy.linalg.solve_discrete_are(A.T, C.T, Q + share * size * np.eye(len(A)), R, s=S)
        except (np.linalg.LinAlgError, ValueError):
            continue
        K = np.asarray(np.linalg.solve(C @ P @ C.T + R, (A @ P @ C.T + S).T).T)
        if spectral_radius(A - K @ C) < 1.0:
            return K
    raise IdentificationError(
        f"the identified model has no stable predictor: it is not detectable from its outputs, "
        f"spectral radius {spectral_radius(A):.4g}"
    )


def input_matrices(
    record: Record, v: Array, A: Array, C: Array, gain: Array, direct: bool, known: StateSpace |
    None = None,
) -> tuple[Array, Array]:  # fmt: skip
    """B (n, p) and D (m, p) of the inputs v (N, p) by least squares on the record.

    x_{k+1} = (A - G C) x_k + (B - G D) v_k + G y_k, y_k = C x_k + D v_k is linear in B, D and the
    first state of every stretch, for any G. With G = 0 the error of a free run is minimised, with a
    stabilising G that of a predictor. The response of the model `known` to the inputs `record.u`
    is subtracted first. The solution has minimal norm where the columns are dependent.
    """
    n, m, p, r = len(A), len(C), v.shape[1], record.u.shape[1]
    B, D = (np.zeros((n, r)), np.zeros((m, r))) if known is None else (known.B, known.D)
    inputs, through = np.hstack([gain, B - gain @ D]), np.hstack([np.zeros((m, m)), D])
    observer = StateSpace(A - gain @ C, inputs, C, through, 1.0)
    target = record.y - np.vstack([observer.simulate(np.hstack(part)) for part in record.parts()])
    stretch, chosen = record.stretch - record.stretch[0], np.sort(record.times)
    states, v = n * (int(stretch[-1]) + 1), np.ascontiguousarray(v)
    x = np.zeros((n, n * p + (m * p if direct else 0) + states))

    def rows() -> Iterator[Array]:
        """The regressors and the target as last column, in blocks of rows."""
        for turn in turns(len(v)):
            phi = np.zeros((len(v[turn]), m, x.shape[1]))
            _responses(observer.A, C, gain, v, stretch, direct, turn.start, x, phi)
            among = slice(*np.searchsorted(chosen, [turn.start, turn.start + len(phi)]))
            used = chosen[among] - turn.start
            columns = phi[used].reshape(len(used) * m, -1)
            yield np.column_stack([columns, target[turn][used].ravel()])

    R = triangle(rows())
    size = np.linalg.norm(R[:, :-1], axis=0)
    size = np.where(size > 0.0, size, 1.0)
    solution = np.linalg.lstsq(R[:, :-1] / size, R[:, -1], rcond=DETERMINED)[0] / size
    n_direct = m * p if direct else 0
    D = solution[n * p : n * p + n_direct].reshape(-1, m).T if direct else np.zeros((m, p))
    return solution[: n * p].reshape(p, n).T, D


@kernel
def _responses(
    A: Array, C: Array, G: Array, v: Array, stretch: Codes, direct: bool, begin: int, x: Array,
    phi: Array,
) -> None:  # fmt: skip
    """Write d y_k / d (B, D, first states) for the rows k from `begin`, B and D input by input.

    phi (rows, m, q) must be zero on entry; x (n, q), of the state, is updated in place.
    """
    n, m, p, q = A.shape[0], C.shape[0], v.shape[1], phi.shape[2]
    first = n * p + (m * p if direct else 0)
    following = np.zeros((n, q))
    for k in range(begin, begin + phi.shape[0]):
        if k == 0 or stretch[k] != stretch[k - 1]:
            x[:] = 0.0
            for i in range(n):
                x[i, first + n * stretch[k] + i] = 1.0
        for i in range(m):
            for j in range(n):
                for c in range(q):
                    phi[k - begin, i, c] += C[i, j] * x[j, c]
        following[:] = 0.0
        for i in range(n):
            for j in range(n):
                for c in range(q):
                    following[i, c] += A[i, j] * x[j, c]
        for c in range(p):
            for i in range(n):
                following[i, n * c + i] += v[k, c]
            for i in range(m if direct else 0):
                phi[k - begin, i, n * p + m * c + i] += v[k, c]
                for j in range(n):
                    following[j, n * p + m * c + i] -= G[j, i] * v[k, c]
        x[:] = following


class VariantChoice(NamedTuple):
    """The chosen alternative, the p-value of no feedback, and the errors of all alternatives."""

    alternative: Alternative
    p_value: float
    errors: dict[str, FoldErrors]  # a run for each block left out


def select_variant(
    y: Array, u: Array, L: int, J: int, order: int | None, alternatives: Sequence[Alternative] =
    tuple(NAMES), *, stable: bool = False, stretch: Codes | None = None, file: Codes | None = None,
) -> VariantChoice:  # fmt: skip
    """Choose one of the alternatives, the simplest first, by blocks left out.

    Without feedback from past outputs all are consistent, and the simulation decides, from the
    state that fits the block best: predictions would use past outputs, which hide a wrong response.
    With feedback `open` is biased by the past noise in the input, and because of that noise
    simulates the record better than the truth does; the one-step prediction error does not, if the
    noise is modelled: Ljung (1999), System Identification, section 13.4. The error of a block is
    the mean square over the variance, of each output at most that of the mean.

    At most MAX_SAMPLES are used. Where `file` (N,) numbers several files, these are the blocks.
    Raises IdentificationError when the data are too few for the test of feedback.
    """
    y, u = y[:MAX_SAMPLES], u[:MAX_SAMPLES]
    parts = np.zeros(len(y), dtype=np.int64) if stretch is None else stretch[:MAX_SAMPLES]
    record = Record(y, u, parts, np.arange(len(y)))
    p_value = feedback_p_value(record, J)
    file = None if file is None else file[:MAX_SAMPLES]
    splits = blocked_k_fold(len(y), FOLDS, file=file)
    samples = np.array([float(np.count_nonzero(test)) for _, test in splits])
    errors = {NAMES[one]: np.ones((len(splits), y.shape[1])) for one in alternatives}
    for i, (train, test) in enumerate(splits):
        number = 2 * parts + (np.cumsum(test) > 0)  # no window may bridge the block left out
        left_out = Record(y[test], u[test], parts[test], record.times[test])
        for variant, direct in alternatives:
            with suppress(IdentificationError):
                model = identify_innovations(
                    y[train], u[train], L, J, order, variant, feedthrough=direct, stable=stable,
                    stretch=number[train],
                ).model  # fmt: skip
                error = relative_squares(model, left_out, p_value >= FEEDBACK_P)
                errors[NAMES[variant, direct]][i] = np.fmin(error, 1.0)  # that of the mean
    found = {name: FoldErrors(squares, samples) for name, squares in errors.items()}
    best = one_standard_error_rule(found)
    return VariantChoice(next(one for one in alternatives if NAMES[one] == best), p_value, found)


def feedback_p_value(record: Record, J: int) -> float:
    """The p-value of the hypothesis that no input depends on past outputs; 1 without noise.

    Without feedback the innovations e are independent of all inputs. u_k is regressed on J past
    samples of u, and of e beside them; an F-test compares the two. The result is the least p-value
    of the inputs, times their number (Bonferroni). Caines and Chan (1975), Feedback between
    stationary stochastic processes, IEEE Transactions on Automatic Control 20.
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
    return float(min(1.0, r * np.min(scipy.special.fdtrc(b, left, ratio), initial=1.0)))


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
    return np.asarray(np.divide(square, variance, out=np.zeros_like(square), where=variance > 0.0))
