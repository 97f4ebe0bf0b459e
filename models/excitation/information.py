"""Information of manoeuvres, and the optimal mix of them for estimating the coefficients.

    Gamma_q = (1/N) sum_k phi(k) phi(k)'                 of manoeuvre q, phi as in tau = theta' phi
    N* = argmax log det (N_1 Gamma_1 + ... + N_Q Gamma_Q),  N_1 + ... + N_Q = N,  N_q >= 0

Ljungberg (slides), "Informative mix of sub-experiments". If the instruments are the regressors of
a noise-free simulation, Z = Phi, every Gamma_q is symmetric and the problem is concave: D-optimal
design. Every term is estimated in every degree of freedom, so the information of all coefficients
is block diagonal with one copy of Gamma per degree of freedom, and has the same optimum.

Before the identification, a report states whether a recording separates the terms of a model. For
each degree of freedom the regressors are the terms that the model has there, each scaled to unit
norm. A small singular value means that a combination of terms has almost no effect on the data;
no method can identify that combination. The report also counts the spectral lines of the force; a
linear regression requires half as many as it has unknowns (Ljung (1999), 13.2). They are counted
over the entire experiment, since a longer record resolves more of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from seatrial.models.errors import ConfigurationError
from seatrial.models.recording.recording import Recording
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import Array, each_product_once
from seatrial.models.vessel.table import Vessel

Integers = NDArray[np.int64]
OPTIMALITY_GAP = 1e-6  # at which the search for the optimum stops
MOST_STEPS = 200_000
ZERO_EIGENVALUE = 1e-12  # of an eigenvalue, relative to the largest, of scaled information
MIN_WEIGHT = 0.2  # smallest relative weight of a term that belongs to a combination
LEAST_SINGULAR_VALUE = 0.01  # of a singular value, relative to the largest
LEAST_LINE = 0.01  # smallest amplitude of a spectral line, relative to the largest


@dataclass(frozen=True, eq=False)
class Weights:
    """Shares w_q >= 0 of the manoeuvres, shape (Q,), with sum one, and their optimality gap."""

    share: Array
    gap: float  # max_q tr(Gamma^-1 Gamma_q) - n, zero at the optimum


def information(phi: Array) -> Array:
    """Gamma = (1/N) sum_k phi(k) phi(k)', shape (n, n), of regressors phi (N, n)."""
    return np.asarray(phi.T @ phi / len(phi))


def log_det(gammas: Array, counts: Array) -> float:
    """log det of sum_q N_q Gamma_q; -inf where it is singular. gammas (Q, n, n), counts (Q,)."""
    sign, value = np.linalg.slogdet(np.tensordot(counts, gammas, axes=1))
    return float(value) if sign > 0.0 else -np.inf


def scaled(gammas: Array) -> Array:
    """Information (Q, n, n) with every term scaled by its root mean square over all manoeuvres.

    The scaling adds a constant to every log det.
    """
    size = np.sqrt(np.mean(np.diagonal(gammas, axis1=1, axis2=2), axis=0))
    size = np.where(size > 0.0, size, 1.0)
    return np.asarray(gammas / np.outer(size, size))


def inseparable(gamma: Array, names: Sequence[str]) -> tuple[str, ...]:
    """The terms that scaled information (n, n) does not separate; empty if it separates all."""
    values, ways = np.linalg.eigh(gamma)
    if values[0] > ZERO_EIGENVALUE * values[-1]:
        return ()
    return _members(ways[:, 0], names)


def sensitivities(gammas: Array, share: Array) -> Array:
    """d_q = tr(Gamma^-1 Gamma_q) with Gamma = sum_q w_q Gamma_q, shape (Q,).

    Kiefer and Wolfowitz (1960): w is optimal where no d_q exceeds n, the size of Gamma.
    """
    inverse = np.linalg.inv(np.tensordot(share, gammas, axes=1))
    return np.asarray(np.einsum("ij,qji->q", inverse, gammas))


def optimal(gammas: Array, names: Sequence[str]) -> Weights:
    """The D-optimal shares by the multiplicative algorithm w_q <- w_q d_q / n.

    Titterington (1976). log det does not decrease. A manoeuvre that no optimum contains is removed
    as soon as the distance from the optimum proves it: Harman and Pronzato (2007), theorem 1.
    Raises ConfigurationError if all manoeuvres together do not separate the terms.
    """
    gammas = scaled(gammas)
    names_left = inseparable(np.mean(gammas, axis=0), names)
    if names_left:
        raise ConfigurationError(
            "excitation.candidates: all manoeuvres together do not separate "
            f"{', '.join(names_left)}, expected others"
        )
    n = gammas.shape[1]
    share = np.full(len(gammas), 1.0 / len(gammas))
    for _ in range(MOST_STEPS):
        d = sensitivities(gammas, share)
        gap_left = float(np.max(d) - n)
        if gap_left <= OPTIMALITY_GAP:
            break
        share *= d / n
        share[d < _threshold(gap_left, n)] = 0.0
        share /= np.sum(share)
    return Weights(share, gap_left)


def _threshold(left: float, n: int) -> float:
    """d_q below which a manoeuvre is in no optimum, with max_q d_q = n + left.

    The least eigenvalue of Gamma^-1 Gamma* with a trace of at most n + left and an inverse of
    trace at most n, times n; so it holds for information of any rank.
    """
    least = 1.0 + 0.5 * left - 0.5 * np.sqrt(left * (4.0 + left - 4.0 / n))
    return float(n * least * (1.0 - 1e-9))


def largest_remainder(share: Array, total: int) -> Integers:
    """Whole counts of sum `total` by the largest remainder (Hamilton), shape (Q,).

    Of equal remainders the first are rounded up.
    """
    exact = share / np.sum(share) * total
    counts = np.floor(exact + 1e-9).astype(np.int64)
    remainder = np.round(exact - counts, 9)
    order = np.argsort(-remainder, kind="stable")
    counts[order[: total - int(np.sum(counts))]] += 1
    return counts


@dataclass(frozen=True)
class Persistence:
    """Persistence of excitation of a recording for one degree of freedom."""

    dof: str
    terms: tuple[str, ...]
    unexcited: tuple[str, ...]  # terms that are zero throughout
    inseparable: tuple[tuple[str, ...], ...]  # groups of terms, the least separable first
    condition: float  # of the scaled regressors that are excited
    rank: int
    lines: int  # spectral lines of the force, or of the inputs

    @property
    def unknowns(self) -> int:
        """Number of terms."""
        return len(self.terms)

    def warning(self) -> str | None:
        """A line on the terms that are not separated, the worst by name; None if all are."""
        parts = []
        if self.unexcited:
            parts.append(f"{', '.join(self.unexcited)} not excited")
        parts += [f"{' and '.join(group)} not separable" for group in self.inseparable[:1]]
        if len(self.inseparable) > 1:
            parts.append(f"further groups: {len(self.inseparable) - 1}")
        if not parts:
            return None
        few = f", {self.lines} spectral lines" if 2 * self.lines < self.unknowns else ""
        summary = f"{self.rank} of {self.unknowns} terms separable{few}"
        return f"{self.dof}: {summary}: {'; '.join(parts)}"


def persistence(
    recording: Recording, model: Vessel, whole: Recording | None = None
) -> tuple[Persistence, ...]:
    """The report on a recording, one entry per degree of freedom, for the terms of a model.

    `whole` is the experiment that the recording is a part of, if any.
    """
    x, driven = recording.variables(), whole or recording
    if driven.inputs is None:
        lines = [spectral_lines(force) for force in driven.tau.T]
    else:  # all inputs act on every degree of freedom
        lines = [sum(spectral_lines(values) for values in driven.inputs.T)] * len(model.dofs)
    reports = []
    for dof, own, count in zip(model.dofs, model.theta.T, lines, strict=True):
        terms = [term for term, value in zip(model.terms, own, strict=True) if value != 0.0]
        if not model.forces_known:  # nor is the scale of the coefficients
            terms = [t for t in each_product_once(terms) if t.name not in model.accelerations]
        names, phi = np.array([term.name for term in terms], dtype=str), basis.evaluate(terms, x)
        size = np.linalg.norm(phi, axis=0)
        excited = size > 0.0
        _, values, ways = np.linalg.svd(phi[:, excited] / size[excited], full_matrices=False)
        rank = int(np.sum(values > LEAST_SINGULAR_VALUE * values[0])) if len(values) else 0
        groups = dict.fromkeys(_members(way, names[excited].tolist()) for way in ways[rank:][::-1])
        condition = float(values[0] / values[-1]) if len(values) and values[-1] > 0.0 else np.inf
        named = tuple(names.tolist()), tuple(names[~excited].tolist()), tuple(groups)
        reports.append(Persistence(dof, *named, condition, rank, count))
    return tuple(reports)


def _members(way: Array, names: Sequence[str]) -> tuple[str, ...]:
    """The terms that form a combination."""
    weight = np.abs(way) / np.max(np.abs(way))
    return tuple(name for name, share in zip(names, weight, strict=True) if share > MIN_WEIGHT)


def spectral_lines(force: Array) -> int:
    """Number of frequencies in a force (N,), the mean and neighbours of a line left out.

    Only the interval between the first and the last non-zero sample is used.
    """
    nonzero = np.flatnonzero(force)
    if not len(nonzero):
        return 0
    force = force[nonzero[0] : nonzero[-1] + 1]
    amplitude = np.abs(np.fft.rfft((force - np.mean(force)) * np.hanning(len(force))))
    if not np.max(amplitude, initial=0.0) > 1e-12 * np.max(np.abs(force), initial=0.0):
        return 0
    inner = amplitude[1:-1]
    peak = (inner >= amplitude[:-2]) & (inner > amplitude[2:])
    return int(np.sum(peak & (inner > LEAST_LINE * np.max(amplitude))))
