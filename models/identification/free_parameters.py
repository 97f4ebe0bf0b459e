"""The free coefficients of a nominal model, and the table as a function of them.

The table is linear in the free parameters,

    theta(p) = theta_nominal + L (p - p_nominal),

where an entry of p is one coefficient (degree of freedom, term). Where the nominal table holds
the Coriolis and centripetal force of its own inertia (Kirchhoff's equations, `vessel.coriolis`,
itself linear in the inertia), that force changes with the inertia parameters: `coriolis: tied`.
Then nu' C(nu) nu = 0 holds, so no candidate can create energy, and there are fewer parameters:
20 for milliAmpere (5 inertia, 15 damping). With `coriolis: free` every nonzero entry is a
parameter, 26 for milliAmpere.

Parameters of devices, such as `rudder.gamma_R_plus`, follow those of the table.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import ACCELERATIONS
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import Array, Term
from seatrial.models.vessel.derivatives import coriolis, without_munk_moment
from seatrial.models.vessel.devices.device import Bounds, Device, with_parameters
from seatrial.models.vessel.table import Vessel, coefficient_unit
from seatrial.models.weather.disturbance import ConstantForce

ZERO_COEFFICIENT = 1e-9  # of the largest coefficient: smaller entries are rounding errors
NED = ("north", "east")
WINDAGE = ("surge.V_qu_q", "sway.V_qv_q", "yaw.u_qv_q")  # of a vessel in surge, sway and yaw
Coriolis = Literal["tied", "free"]


@dataclass(frozen=True, eq=False)
class FreeParameters:
    """The free coefficients of a nominal model, then the free parameters of devices; SI units."""

    nominal: Vessel  # with a row for every free term
    labels: tuple[str, ...]  # such as `surge.u_dot`, `yaw.|r|r`, and `north` and `east`
    units: tuple[str, ...]
    values: Array  # nominal values, shape (m,)
    directions: Array  # L, shape (n_terms n_dof, m), zero for parameters of devices
    places: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    # among the parameters of all devices, those that are free

    def __len__(self) -> int:
        return len(self.labels)

    def tables(self, points: Array) -> Array:
        """theta of many design points (n_points, m); shape (n_points, n_terms, n_dof)."""
        change = (points - self.values) @ self.directions.T
        return np.asarray(self.nominal.theta + change.reshape(len(points), *self.shape))

    @property
    def of_devices(self) -> slice:
        """The parameters of devices, which are the last ones."""
        return slice(len(self) - len(self.places), len(self))

    @property
    def plausible(self) -> list[tuple[int, Bounds]]:
        """Index and plausible range of each parameter of a device."""
        bounds = [self.nominal.installed.bounds[place] for place in self.places]
        return list(enumerate(bounds, self.of_devices.start))

    @property
    def dofs(self) -> tuple[str, ...]:
        """Degree of freedom of each parameter; `all` for a force in NED and for devices."""
        known = (label.partition(".")[0] for label in self.labels)
        return tuple(dof if dof in self.nominal.dofs else "all" for dof in known)

    def device_parameters(self, points: Array) -> Array:
        """Parameters of all devices (n_parameters, n) at design points (n, m)."""
        values = np.repeat(self.nominal.installed.parameters[:, None], len(points), axis=1)
        values[self.places] = points[:, self.of_devices].T
        return values

    def model(self, nominal: Vessel, point: Array) -> Vessel:
        """The nominal model with the parameters of a design point (m,)."""
        model = nominal + self.residual(point)
        if not len(self.places):
            return model
        return replace(model, devices=self.devices(point))

    def devices(self, point: Array) -> dict[str, Device]:
        """The devices with the parameters of a design point (m,)."""
        values = self.device_parameters(point[None])[:, 0].tolist()
        return with_parameters(self.nominal.devices, values)

    def device_errors(self, errors: Array) -> dict[str, float]:
        """Standard errors of the devices' parameters by label, of those of all (m,)."""
        own = self.of_devices
        return dict(zip(self.labels[own], errors[own].tolist(), strict=True))

    @property
    def shape(self) -> tuple[int, int]:
        """Shape of the table."""
        return len(self.nominal.terms), len(self.nominal.dofs)

    @property
    def slopes(self) -> Array:
        """Derivative of the table by the parameters, shape (n_terms, n_dof, m)."""
        return self.directions.reshape(*self.shape, -1)

    @property
    def support(self) -> NDArray[np.bool_]:
        """Entries of the table that can be other than zero, bool, shape (n_terms, n_dof)."""
        moved = np.any(self.directions != 0.0, axis=1).reshape(self.shape)
        return np.asarray((self.nominal.theta != 0.0) | moved)

    def residual(self, point: Array) -> Vessel:
        """Identified - nominal, for a design point (m,)."""
        change = (self.directions @ (point - self.values)).reshape(self.shape)
        return replace(self.nominal, theta=change)

    def change(self, table: Array) -> Array:
        """The change (m,) of the parameters that comes nearest to that of the table.

        `table` (n_terms, n_dof) is identified - nominal. The entries of a parameter are averaged.
        """
        return np.asarray(np.linalg.lstsq(self.directions, table.ravel(), rcond=None)[0])

    def std_error(self, covariance: Array) -> Array:
        """Standard errors of the table's entries from cov(p) (m, m); NaN where nothing is free."""
        variance = np.einsum("ij,jk,ik->i", self.directions, covariance, self.directions)
        free = np.any(self.directions != 0.0, axis=1)
        errors = np.where(free, np.sqrt(np.maximum(variance, 0.0)), np.nan)
        return np.asarray(errors.reshape(self.shape))


def free_parameters(
    nominal: Vessel,
    labels: Sequence[str] | None,
    tie: Coriolis,
    ned_force: bool,
    symmetric: bool = False,
) -> FreeParameters:
    """The parameters named by `labels`, or by default the nominal table's nonzero coefficients.

    A label is `dof.term`; the nominal table need not have the term.
    `ned_force` adds `north` and `east`, a force that is constant in NED; a vessel that moves along
    one axis only is affected by the northward component. With `symmetric` two entries of the
    inertia that mirror each other and are equal in the nominal table are one parameter. Raises
    ConfigurationError for labels that are unknown or repeated.
    """
    own = own_coriolis(nominal) if tie == "tied" else None
    if labels is None:
        labels = [label for label, _ in nonzero_labels(nominal, tie)]
    entries = tuple(parse_label(label, nominal) for label in labels)
    if not (entries or nominal.devices):
        raise ConfigurationError(f"parameters: {nominal.name} has no coefficient to identify")
    pairs = _mirrored(nominal, entries) if symmetric else {}
    entries = tuple(entry for entry in entries if entry not in pairs.values())
    for i, (dof, term) in enumerate(entries):
        if (dof, term) in entries[:i]:
            raise ConfigurationError(f"parameters: {dof}.{term} is given twice")
    forces = ned_forces(nominal.dofs) if ned_force else {}
    terms = [term for _, term in entries] + [t for force in forces.values() for t in force.terms]
    new = dict.fromkeys(term for term in terms if term not in nominal.terms)
    extended = nominal.on(nominal.terms + tuple(new))
    values = np.array([extended.coefficient(dof, str(term)) for dof, term in entries])
    if own is not None:
        coriolis_table = own.on(extended.terms)
        values -= [coriolis_table.coefficient(dof, str(term)) for dof, term in entries]
    directions = [
        sum(_direction(extended, *e, own is not None) for e in (entry, pairs.get(entry)) if e)
        for entry in entries
    ]
    names = [f"{dof}.{term}" for dof, term in entries]
    units = [coefficient_unit(term, dof) for dof, term in entries]
    for name, force in forces.items():
        names, units, values = [*names, name], [*units, "N"], np.append(values, 0.0)
        directions.append(np.asarray(force.on(extended.terms).theta).ravel())
    L = np.array(directions).reshape(len(names), extended.theta.size).T
    return FreeParameters(extended, tuple(names), tuple(units), values, L)


TABLE = "table"  # in a list of what is free: the coefficients of the table


def with_devices(free: FreeParameters, patterns: Sequence[str]) -> FreeParameters:
    """The free parameters with those of devices whose labels match one of the patterns.

    A pattern is a label or has wildcards, as `rudder.*`. Raises ConfigurationError for a pattern
    without a match.
    """
    devices = free.nominal.installed
    for pattern in patterns:
        if not any(fnmatchcase(label, pattern) for label in devices.labels):
            raise ConfigurationError(
                f"identifier.free: got {pattern!r}, expected {TABLE}, a coefficient such as "
                f"{free.nominal.dofs[0]}.{free.nominal.terms[0]}, or parameters of devices: "
                f"{', '.join(devices.labels) or free.nominal.name + ' has none'}"
            )
    chosen = [
        i for i, label in enumerate(devices.labels) if any(fnmatchcase(label, p) for p in patterns)
    ]
    return replace(
        free,
        labels=free.labels + tuple(devices.labels[i] for i in chosen),
        units=free.units + tuple(devices.bounds[i].unit for i in chosen),
        values=np.append(free.values, devices.parameters[chosen]),
        directions=np.pad(free.directions, ((0, 0), (0, len(chosen)))),
        places=np.array(chosen, dtype=np.int64),
    )


def ned_forces(dofs: tuple[str, ...]) -> dict[str, Vessel]:
    """The tables of a force of 1 N to the north and to the east, those that act on a vessel."""
    tables = {}
    for name, (north, east) in zip(NED, np.eye(len(NED)), strict=True):
        table = ConstantForce(north, east, 0.0).table(dofs)
        acts = np.any(table.theta != 0.0, axis=1)
        terms = tuple(term for term, row in zip(table.terms, acts, strict=True) if row)
        if terms:
            tables[name] = table.on(terms)
    return tables


def parse_label(label: str, nominal: Vessel) -> tuple[str, Term]:
    """Split a label such as `surge.|u|u` into the degree of freedom and the term.

    Raises ConfigurationError for an unknown degree of freedom or term.
    """
    dof, _, name = label.partition(".")
    if dof not in nominal.dofs or not name:
        raise ConfigurationError(
            f"parameters: got {label!r}, expected one of the degrees of freedom "
            f"{', '.join(nominal.dofs)} and a term, such as {nominal.dofs[0]}.{nominal.terms[0]}"
        )
    return dof, basis.term(name)


def own_coriolis(nominal: Vessel) -> Vessel | None:
    """C(nu) nu of the nominal inertia; None unless the nominal table has all of its entries.

    That of a vessel with inputs has no Munk moment if the table has none (method of MMG), and is
    not tied if no device gives a force that would determine the inertia.
    """
    if not nominal.forces_known:
        return None
    force = _coriolis_like(nominal, nominal.inertia)
    if not force.terms:
        return None
    entries = nominal.on(force.terms).theta
    return force if np.all(entries[force.theta != 0.0] != 0.0) else None


def _coriolis_like(nominal: Vessel, inertia: Array) -> Vessel:
    """C(nu) nu of an inertia (n_dof, n_dof), without the Munk moment where there is none."""
    force = coriolis(inertia, nominal.dofs)
    mmg = nominal.inputs and "yaw" in nominal.dofs and nominal.coefficient("yaw", "uv") == 0.0
    return without_munk_moment(force) if mmg else force


def nonzero_labels(nominal: Vessel, tie: Coriolis) -> list[tuple[str, Term]]:
    """Label and term of every coefficient of a table above rounding, inertia first.

    Without its Coriolis forces where they are tied to the inertia, and without the inertia where
    no force is known.
    """
    own = own_coriolis(nominal) if tie == "tied" else None
    entries = _nonzero(nominal if own is None else nominal - own)
    if not nominal.forces_known:
        entries = tuple(e for e in entries if e[1].name not in nominal.accelerations)
    return [(f"{dof}.{term}", term) for dof, term in entries]


def _nonzero(vessel: Vessel) -> tuple[tuple[str, Term], ...]:
    """Entries (degree of freedom, term) of a table above rounding, inertia first."""
    scale = ZERO_COEFFICIENT * np.max(np.abs(vessel.theta), initial=0.0)
    inertial = [term for term in vessel.terms if term.name in ACCELERATIONS]
    rest = [term for term in vessel.terms if term.name not in ACCELERATIONS]
    return tuple(
        (dof, term)
        for term in inertial + rest
        for dof in vessel.dofs
        if abs(vessel.coefficient(dof, str(term))) > scale
    )


def _mirrored(
    nominal: Vessel, entries: Sequence[tuple[str, Term]]
) -> dict[tuple[str, Term], tuple[str, Term]]:
    """The mirror image of each entry above the diagonal of an inertia that is symmetric there."""
    letters, M = nominal.accelerations, nominal.inertia
    pairs = {}
    for i, dof in enumerate(nominal.dofs):
        for j in range(i + 1, len(nominal.dofs)):
            entry = (dof, basis.term(letters[j]))
            image = (nominal.dofs[j], basis.term(letters[i]))
            if entry in entries and image in entries and M[i, j] == M[j, i]:
                pairs[entry] = image
    return pairs


def _direction(extended: Vessel, dof: str, term: Term, tied: bool) -> Array:
    """Change of the table for one unit of a parameter, shape (n_terms n_dof,)."""
    change = np.zeros((len(extended.terms), len(extended.dofs)))
    change[extended.terms.index(term), extended.dofs.index(dof)] = 1.0
    if tied and term.name in extended.accelerations:
        unit = np.zeros((len(extended.dofs), len(extended.dofs)))
        unit[extended.dofs.index(dof), extended.accelerations.index(term.name)] = 1.0
        change += _coriolis_like(extended, unit).on(extended.terms).theta
    return change.ravel()
