"""An estimated table after the physical constraints and the refinement by free runs.

A table that violates a constraint is moved to the nearest one that does not. So are tables drawn
about it, where its standard errors are to be those of the coefficients: a constraint that binds
narrows the distribution, and what is tied to it moves too.
"""

from dataclasses import replace

import numpy as np

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.identification.attenuation import with_attenuation
from seatrial.models.identification.free_run_fit import refined_by_segments
from seatrial.models.identification.problem import Identified, Problem
from seatrial.models.identification.residual import ResidualOptions, Samples
from seatrial.models.identification.spread import ParameterSpread
from seatrial.models.identification.structured import entries_of, structure
from seatrial.models.vessel.thruster import SecondOrderLag

MOVED_TABLES = 100  # tables about one that was moved


def finished(
    options: ResidualOptions,
    problem: Problem,
    lag: SecondOrderLag | None,
    samples: Samples,
    result: Identified,
) -> Identified:
    """The table after the physical constraints and the refinement that are asked for.

    A table that meets the constraints is not changed by them. `samples` are those of the estimate.
    """
    result = with_attenuation(options, problem, samples, result)
    if options.inertia_factor is None and options.refinement == "none":
        return result
    free, training = entries_of(result.residual, problem.nominal), problem.training
    terms = free.nominal.terms
    if {*terms} <= {*samples.terms}:  # the lack of fit is that of the nominal model too
        samples = samples if terms == samples.terms else samples.on(terms)
    else:
        samples = options.samples(training, free.nominal, lag, terms=terms)
    model = structure(free, samples, training.nu, options.inertia_factor)
    change, broken = model.nearest(result.residual.on(terms).theta)
    if options.refinement == "none" and not broken:
        return result
    errors, spread = result.std_error, result.spread
    rows = [terms.index(term) for term in result.residual.terms]
    if options.refinement == "free_run":
        refined = refined_by_segments(options, training, lag, model, change, 1.0)
        change, broken = refined.change, refined.active
        if not problem.compared:
            errors = free.std_error(refined.covariance)[rows]
            spread = refined.spread(problem.nominal)
    elif options.interval_covers and spread is not None:
        points = [
            free.values + model.nearest((drawn - problem.nominal).on(terms).theta)[0]
            for drawn in result.draws(MOVED_TABLES)
        ]
        covariance = np.cov(np.array(points), rowvar=False)
        errors = free.std_error(covariance)[rows]
        spread = ParameterSpread(problem.nominal, free, free.values + change, covariance)
    residual = free.residual(free.values + change).on(result.residual.terms)
    active = (Diagnostic("active_constraint", "all", 1.0, label=name) for name in broken)
    return replace(
        result,
        model=problem.nominal + residual,
        residual=residual,
        std_error=errors,
        diagnostics=(*result.diagnostics, *active),
        spread=spread,
    )
