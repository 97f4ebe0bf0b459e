"""Information of manoeuvres, and the optimal mix of them for estimating the coefficients.

    Gamma_q = (1/N) sum_k phi(k) phi(k)'                 of manoeuvre q, phi as in tau = theta' phi
    N* = argmax log det (N_1 Gamma_1 + ... + N_Q Gamma_Q),  N_1 + ... + N_Q = N,  N_q >= 0

Ljungberg (slides), "Informative mix of sub-experiments". If the instruments are the regressors of
a noise-free simulation, Z = Phi, every Gamma_q is symmetric and the problem is concave: D-optimal
design. Every term is estimated in every degree of freedom, so the information of all coefficients
is block diagonal with one copy of Gamma per degree of freedom, and has the same optimum.

Before the identification, a report states whether a recording separates the terms that a model has
in each degree of freedom: a small singular value of their regressors, scaled to unit norm, means
that a combination of terms has almost no effect on the data, which no method can identify. A linear
regression also requires half as many spectral lines of the force as it has unknowns (Ljung (1999),
13.2), counted over the entire experiment, since a longer record resolves more of them.
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


def log_det(gammas: Array, counts: Array) -> float:
    """log det of the mean information of a mix; -inf where it is singular.

    gammas (Q, n, n), counts or shares (Q,).
    """
    sign, value = np.linalg.slogdet(np.tensordot(counts / np.sum(counts), gammas, axes=1))
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


def optimal(gammas: Array, names: Sequence[str]) -> tuple[Array, float]:
    """The D-optimal shares w_q >= 0 of the manoeuvres, (Q,), with sum one, and their gap.

    The gap is max_q d_q - n for d_q = tr(Gamma^-1 Gamma_q) with Gamma = sum_q w_q Gamma_q of size
    n; w is optimal where no d_q exceeds n: Kiefer and Wolfowitz (1960). By the multiplicative
    algorithm w_q <- w_q d_q / n, log det does not decrease: Titterington (1976). A manoeuvre that
    no optimum contains is removed as soon as the gap proves it, for information of any rank: Harman
    and Pronzato (2007), theorem 1.

    Raises ConfigurationError if all manoeuvres together do not separate the terms.
    """
    gammas = scaled(gammas)
    if names_left := inseparable(np.mean(gammas, axis=0), names):
        raise ConfigurationError(
            "excitation.candidates: all manoeuvres together do not separate "
            f"{', '.join(names_left)}, expected others"
        )
    n, share = gammas.shape[1], np.full(len(gammas), 1.0 / len(gammas))
    for _ in range(MOST_STEPS):
        inverse = np.linalg.inv(np.tensordot(share, gammas, axes=1))
        d = np.einsum("ij,qji->q", inverse, gammas)
        gap = float(np.max(d) - n)
        if gap <= OPTIMALITY_GAP:
            break
        least = 1.0 + 0.5 * gap - 0.5 * np.sqrt(gap * (4.0 + gap - 4.0 / n))
        share *= np.where(d < n * least * (1.0 - 1e-9), 0.0, d / n)
        share /= np.sum(share)
    return share, gap


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

    def warning(self) -> str | None:
        """A line on the terms that are not separated, the worst by name; None if all are."""
        parts = [f"{', '.join(self.unexcited)} not excited"] if self.unexcited else []
        parts += [f"{' and '.join(group)} not separable" for group in self.inseparable[:1]]
        if not parts:
            return None
        few = f", {self.lines} spectral lines" if 2 * self.lines < len(self.terms) else ""
        return f"{self.dof}: {self.rank} of {len(self.terms)} terms separable{few}: " + "; ".join(
            parts
        )


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
    if not np.any(force):
        return 0
    force = np.trim_zeros(force)
    amplitude = np.abs(np.fft.rfft((force - np.mean(force)) * np.hanning(len(force))))
    if not np.max(amplitude, initial=0.0) > 1e-12 * np.max(np.abs(force), initial=0.0):
        return 0
    inner = amplitude[1:-1]
    peak = (inner >= amplitude[:-2]) & (inner > amplitude[2:])
    return int(np.sum(peak & (inner > LEAST_LINE * np.max(amplitude))))
