"""An estimated table after the physical constraints and the refinement by free runs.

A table that violates a constraint is moved to the nearest one that does not. So are tables drawn
about it, where its standard errors are to be those of the coefficients: a constraint that binds
narrows the distribution, and what is tied to it moves too. Before, it is asked how far noise in the
regressors attenuates the coefficients, which standard errors do not show.
"""

from dataclasses import replace

import numpy as np
import scipy

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.identification.free_run_fit import refined
from seatrial.models.identification.problem import Identified, Problem
from seatrial.models.identification.residual import (
    ResidualOptions,
    Samples,
    evaluated,
    smoothed,
    turns,
)
from seatrial.models.identification.structured import Structure, entries_of
from seatrial.models.identification.uncertainty import ParameterSpread
from seatrial.models.recording.recording import Recording
from seatrial.models.recording.signals import (
    ABOVE_FLOOR,
    NEGLIGIBLE_NOISE,
    SEGMENT,
    cross_density,
    noise_band,
    noise_floor,
)
from seatrial.models.vessel.basis import Array, evaluate
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag

MOVED_TABLES = 100  # tables about one that was moved
WORTH_A_WARNING = 0.05  # of a nominal coefficient
CONFIDENCE = 0.95  # that no loss is within the interval of its coefficient, of all together
EIGENVALUE_RESOLUTION = 1e-12  # of the eigenvalues of scaled columns
PERIODOGRAMS = 8  # least number of them for a coherence
EXPLAINED = 0.8  # of an acceleration's noise, if it was computed from the velocity


def derivative_response(
    velocity: Array, acceleration: Array, period_s: float
) -> tuple[Array, Array] | None:
    """How an acceleration (N,) was computed from a velocity (N,); None if it was measured.

    Frequencies [Hz] and H of the response i H. A measured acceleration holds more than the velocity
    explains at the frequencies at which the velocity is noise.
    """
    length = min(max(len(velocity) // PERIODOGRAMS, 2), SEGMENT)
    both = np.column_stack([velocity, acceleration])
    frequency, powers = cross_density(both, both, period_s, length)
    cross = cross_density(velocity, acceleration, period_s, length)[1]
    own, other = np.real(powers).T
    floor = np.median(own[noise_band(frequency, 0.5 / period_s)])
    noise = own < ABOVE_FLOOR * floor
    explained = np.sum(np.abs(cross[noise]) ** 2 / own[noise])
    if not explained > EXPLAINED * np.sum(other[noise]):
        return None
    return frequency, np.imag(cross) / own


def noise_like(recording: Recording, rng: np.random.Generator) -> tuple[Array, Array]:
    """Velocity and acceleration noise (N, n_dof) with the spectra of that of a recording.

    That of a velocity is white, with the density above 0.8 of the Nyquist frequency; that of an
    acceleration too, or, if it was computed from the velocity, the derivative of the velocity's.
    """
    period = recording.period_s
    floors = [recording.noise, noise_floor(recording.nu_dot, recording.piece_starts, period)]
    velocity, acceleration = (
        np.where(floor.share > NEGLIGIBLE_NOISE, floor.deviation, 0.0)
        * rng.standard_normal(recording.nu.shape)
        for floor in floors
    )
    frequency = np.fft.rfftfreq(len(recording), period)
    for k in np.flatnonzero(np.any(velocity != 0.0, axis=0)):
        response = derivative_response(recording.nu[:, k], recording.nu_dot[:, k], period)
        if response is not None:
            spectrum = 1j * np.interp(frequency, *response) * np.fft.rfft(velocity[:, k])
            acceleration[:, k] = np.fft.irfft(spectrum, len(recording))
    return velocity, acceleration


def attenuations(phi: Array, again: Array) -> Array:
    """lambda (n_terms,) of columns phi (N, n_terms); `again` are the same with noise once more.

    Least squares on measured regressors Phi + E finds, for noise E that the motion does not know,

        theta_hat -> (I - G^-1 S) theta,   G = mean of (Phi + E)'(Phi + E),   S = mean of E'E

    so a coefficient keeps the share 1 - lambda of its own value, lambda_j = [G^-1 S]_jj: Fuller
    (1987), Measurement Error Models, section 2.2. In closed loop the controller passes slow noise
    on to the motion: lambda is then too large for what a low-pass filter leaves.
    """
    size = np.sqrt(np.einsum("nj,nj->j", phi, phi) / len(phi))
    scale = np.where(size > 0.0, size, 1.0)
    gram, noise = np.zeros((2, len(size), len(size)))
    for part in turns(len(phi)):
        own = phi[part] / scale
        more = np.where(size > 0.0, again[part] / scale - own, 0.0)
        gram += own.T @ own
        noise += more.T @ more
    inverse = np.linalg.pinv(gram, EIGENVALUE_RESOLUTION, hermitian=True)
    return np.asarray(np.clip(np.sum(inverse * noise, axis=1), 0.0, 1.0))


def noticeable(
    samples: Samples, shares: Array, nominal: Vessel, errors: Array | None
) -> list[tuple[int, int]]:
    """Coefficients (term, degree of freedom) that lose more than 5 %, the largest force first.

    shares (n_terms,), errors (n_terms, n_dof). A loss within the interval of the estimate
    (Bonferroni's, for all together) and a coefficient that is nominally zero do not count.
    """
    theta = nominal.on(samples.terms).theta
    count = max(int(np.count_nonzero(theta)), 1)
    interval = -float(scipy.special.ndtri(0.5 * (1.0 - CONFIDENCE) / count))
    loss = shares[:, None] * np.abs(theta)
    hidden = np.zeros_like(loss) if errors is None else interval * np.nan_to_num(errors)
    power = np.einsum("nj,nj->j", samples.phi, samples.phi) / len(samples)
    force = loss * np.sqrt(power)[:, None]
    spread = np.std(samples.force, axis=0)  # zero where nothing pushed
    force = np.divide(force, spread, out=np.zeros_like(force), where=spread > 0.0)
    force[(shares <= WORTH_A_WARNING)[:, None] | (loss <= hidden)] = 0.0
    order = [divmod(int(i), theta.shape[1]) for i in np.argsort(-force, axis=None)]
    return [(i, k) for i, k in order if force[i, k] > 0.0]


def with_attenuation(
    options: ResidualOptions, problem: Problem, samples: Samples, result: Identified
) -> Identified:
    """The result with a diagnostic for each coefficient that noise attenuates, and a warning."""
    training, dofs = problem.training, problem.nominal.dofs
    if problem.compared or not options.noise_remedies:
        return result
    nu, nu_dot = noise_like(training, np.random.default_rng(0))
    if not (np.any(nu) or np.any(nu_dot)):
        return result
    nu += training.nu  # in their place: a long recording fills the memory
    nu_dot += training.nu_dot
    smoothing = options.smoothing(training)
    filtered = options.filtered(
        replace(training, nu=nu, nu_dot=nu_dot, tau_filtered=None, tau_actual=None, loads=None),
        None, smoothing,
    )  # fmt: skip
    del nu, nu_dot
    (again,) = evaluated(filtered, lambda part: evaluate(samples.terms, part.variables()))
    shares = attenuations(samples.phi, smoothed(filtered, again, smoothing))
    errors = None if result.std_error is None else result.std_error[: len(shares)]
    lost = noticeable(samples, shares, problem.nominal, errors)
    if not lost:
        return result
    rows = [
        Diagnostic("attenuation", dofs[k], float(shares[i]), label=samples.terms[i].name)
        for i, k in lost
    ]
    warning = (
        f"noise in the regressors attenuates {rows[0].dof}.{rows[0].label} by "
        f"{100.0 * shares[lost[0][0]]:.0f} %, which its standard error does not show: "
        f"try {' or '.join(options.noise_remedies)}"
    )
    warnings = (*result.warnings, warning)
    return replace(result, diagnostics=(*result.diagnostics, *rows), warnings=warnings)


def finished(
    options: ResidualOptions, problem: Problem, lag: SecondOrderLag | None, samples: Samples,
    result: Identified,
) -> Identified:  # fmt: skip
    """The table, of an estimate from `samples`, after the constraints and the refinement."""
    result = with_attenuation(options, problem, samples, result)
    if options.inertia_factor is None and options.refinement == "none":
        return result
    free, training = entries_of(result.residual, problem.nominal), problem.training
    terms = free.nominal.terms
    if {*terms} <= {*samples.terms}:  # the lack of fit is that of the nominal model too
        samples = samples if terms == samples.terms else samples.on(terms)
    else:
        samples = options.samples(training, free.nominal, lag, terms=terms)
    model = Structure(free, samples, training.nu, options.inertia_factor)
    change, broken = model.nearest(result.residual.on(terms).theta)
    if options.refinement == "none" and not broken:
        return result
    if options.refinement == "free_run":
        return refined(options, problem, lag, model, change, 1.0, result)
    errors, spread = result.std_error, result.spread
    if options.interval_covers and spread is not None:
        points = [
            free.values + model.nearest((drawn - problem.nominal).on(terms).theta)[0]
            for drawn in result.draws(MOVED_TABLES)
        ]
        covariance = np.cov(np.array(points), rowvar=False)
        errors = free.std_error(covariance)[[terms.index(t) for t in result.residual.terms]]
        spread = ParameterSpread(problem.nominal, free, free.values + change, covariance)
    residual = free.residual(free.values + change).on(result.residual.terms)
    active = (Diagnostic("active_constraint", "all", 1.0, label=name) for name in broken)
    return replace(
        result, model=problem.nominal + residual, residual=residual, std_error=errors,
        diagnostics=(*result.diagnostics, *active), spread=spread,
    )  # fmt: skip
