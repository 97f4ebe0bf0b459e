"""Bounds of free parameters that follow from physics and from what is believed of the vessel.

    inertia on the diagonal     M_ii / factor <= M_ii <= factor M_ii
    inertia off the diagonal    |M_ij| <= sqrt(M_ii M_jj), as in a positive definite matrix
    damping of its own axis     0 <= d <= WIDE |d|, if it is believed to dissipate
    other                       |p| <= WIDE |p|
    parameters of devices       the plausible range of the device

with the believed values on the right. A parameter that is believed to be zero has the size that
would explain the recorded force alone (`structured.prior_deviation`). These are bounds of each
parameter by itself, for a search or a trust region; constraints between parameters are in
`physical_constraints`.
"""

import numpy as np

from seatrial.models.findings import Finding
from seatrial.models.identification.free_parameters import NED, FreeParameters, parse_label
from seatrial.models.identification.physical_constraints import dissipates
from seatrial.models.identification.problem import reference_force
from seatrial.models.identification.structured import prior_deviation
from seatrial.models.recording.recording import Recording
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import Array

WIDE = 5.0  # largest parameter other than inertia, over its believed size
SHARE = 0.1  # of its range, the size of a device's parameter that is believed to be zero
ACTIVE = 1e-4  # of the distance between its bounds: a parameter that near to one is at it


def believed_sizes(free: FreeParameters, recording: Recording | None, force: str | None) -> Array:
    """Size (m,) of each parameter; infinite without a recording where it is believed to be zero."""
    sizes = np.where(free.values != 0.0, np.abs(free.values), np.inf)
    if recording is not None:
        phi = basis.evaluate(free.nominal.terms, recording.variables())
        sizes = prior_deviation(free, phi, reference_force(recording, free.nominal, force))
    for i, place in zip(range(len(free))[free.of_devices], free.places, strict=True):
        _, low, high = free.nominal.installed.bounds[place]
        sizes[i] = abs(free.values[i]) or SHARE * (high - low)
    return sizes


def physical_bounds(free: FreeParameters, sizes: Array, factor: float) -> tuple[Array, Array]:
    """Lower and upper bounds (m,) of parameters of the given sizes (m,); `factor` is above 1."""
    table = free.nominal
    lower, upper = -WIDE * sizes, WIDE * sizes
    diagonal = dict(zip(table.dofs, np.diag(table.inertia), strict=True))
    for i, place in zip(range(len(free))[free.of_devices], free.places, strict=True):
        lower[i], upper[i] = table.installed.bounds[place][1:]
    for i, (label, value) in enumerate(zip(free.labels, free.values, strict=True)):
        if label in NED or i >= free.of_devices.start:
            continue
        dof, term = parse_label(label, table)
        k = table.dofs.index(dof)
        if term.name == table.accelerations[k]:
            lower[i], upper[i] = value / factor, value * factor
        elif term.name in table.accelerations:
            other = table.dofs[table.accelerations.index(term.name)]
            upper[i] = np.sqrt(diagonal[dof] * diagonal[other])
            lower[i] = -upper[i]
        elif value > 0.0 and not table.inputs and dissipates(term, table.velocities[k]):
            lower[i] = 0.0
    return lower, upper


def active_bounds(free: FreeParameters, point: Array, box: tuple[Array, Array]) -> list[Finding]:
    """The parameters of a design point (m,) that are at a bound of the box."""
    findings = []
    rows = zip(free.dofs, free.labels, free.units, point, *box, strict=True)
    for dof, label, unit, value, low, high in rows:
        if min(value - low, high - value) <= ACTIVE * (high - low) < np.inf:
            findings.append(Finding("active_bound", dof, float(value), unit, label=label))
    return findings
