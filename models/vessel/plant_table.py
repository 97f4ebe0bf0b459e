"""Tables for the equation of motion: the terms without acceleration, M^-1, and the devices.

Only non-zero entries are evaluated, axis by axis. The candidates of a fit share a `Layout`, which
holds the positions of these entries in their tables.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from seatrial.models.notation import ACCELERATIONS, DOFS, VELOCITIES
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import (
    AIR,
    INDEX,
    N_VARIABLES,
    SIDESLIP,
    SPEED,
    Array,
    Codes,
    Term,
)
from seatrial.models.vessel.devices.device import (
    NO_DEVICES,
    BoundDevices,
    Installed,
    Structure,
    bound_devices,
)

Flags = NDArray[np.bool_]


class PlantTable(NamedTuple):
    """Forward dynamics for the kernels, of one vessel or of many candidates in packs."""

    codes: Codes  # (n_terms, 3), see `basis`
    term: Codes  # (n_entries,) term of each entry, axis after axis
    first: Codes  # (n_dof + 1,) first entry of each axis
    entries: Array  # (n_entries,) coefficients
    inverse_inertia: Array  # (n_dof, n_dof)
    coupled: Flags  # (n_dof, n_dof) entries of M^-1 that can be non-zero
    velocity_index: Codes  # (n_dof,) variables that are the velocities
    magnitudes: Codes  # indices of the velocities whose magnitude is used
    aerodynamic: bool  # whether it has terms in the velocity through the air
    turning: bool  # whether it has Coriolis forces: a current then rotates in body axes
    speed: bool  # whether terms or devices use the speed U
    sideslip: bool  # whether terms or devices use the angle beta
    inputs: Codes  # (n_inputs,) variables that are the inputs; empty if forces are commanded
    axes: Codes  # (n_dof,) degrees of freedom among the six
    devices: tuple[Structure, ...] | BoundDevices
    parameters: Array  # of the devices


def bound_plant(plant: PlantTable, of_packs: bool = False) -> PlantTable:
    """The table in the form that is the same for all devices, for numbers or for packs."""
    return plant._replace(devices=bound_devices(plant.devices, of_packs))


@dataclass(frozen=True, eq=False)
class Layout:
    """Which entries of tables (n_terms, n_dof) are evaluated, and their positions."""

    structure: PlantTable  # with entries and M^-1 of zero
    rows: Codes  # (n_entries,) term of each entry in the table
    columns: Codes  # (n_entries,) degree of freedom of each entry
    inertia: Codes  # (n_dof,) terms that are the accelerations

    def entries(self, tables: Array) -> Array:
        """Coefficients that are evaluated, (n_entries, n), of tables (n, n_terms, n_dof)."""
        return np.ascontiguousarray(tables[:, self.rows, self.columns].T)

    def inverse_inertia(self, tables: Array) -> tuple[Array, Flags]:
        """M^-1 of many tables, shape (n_dof, n_dof, n), and which of them are realistic.

        A table is realistic if its inertia matrix is positive definite (kinetic energy). The
        inverse of the others is set to zero, so that these vessels do not accelerate.
        """
        inertia = tables[:, self.inertia, :].transpose(0, 2, 1)
        if len(self.inertia) == 1:
            positive = inertia[:, 0, 0] > 0.0
        else:
            lowest = np.linalg.eigvalsh(0.5 * (inertia + inertia.transpose(0, 2, 1)))
            positive = lowest[:, 0] > 0.0
        inverse = np.zeros_like(inertia)
        inverse[positive] = np.linalg.inv(inertia[positive])
        return np.ascontiguousarray(inverse.transpose(1, 2, 0)), positive

    def plant(self, theta: Array, inverse_inertia: Array) -> PlantTable:
        """Forward dynamics of one table (n_terms, n_dof) and its M^-1 (n_dof, n_dof)."""
        return self.structure._replace(
            entries=np.ascontiguousarray(theta[self.rows, self.columns]),
            inverse_inertia=np.ascontiguousarray(inverse_inertia),
        )


def layout(
    terms: Sequence[Term],
    dofs: Sequence[str],
    support: Flags,
    inputs: Sequence[str] = (),
    devices: Installed = NO_DEVICES,
) -> Layout:
    """Layout of tables over `terms`; support (n_terms, n_dof) marks possible non-zeros."""
    marks, driven = np.asarray(support, dtype=bool).tobytes(), bool(devices.structures)
    positions = _layout(tuple(terms), tuple(dofs), marks, tuple(inputs), driven)
    structure = positions.structure._replace(
        devices=devices.structures, parameters=devices.parameters
    )
    return replace(positions, structure=structure)


@lru_cache(maxsize=64)
def _layout(
    terms: tuple[Term, ...],
    dofs: tuple[str, ...],
    marks: bytes,
    inputs: tuple[str, ...],
    driven: bool,
) -> Layout:
    """The layout without devices; vessels that differ in their numbers alone share it."""
    support = np.frombuffer(marks, dtype=bool).reshape(len(terms), len(dofs))
    columns = [DOFS.index(dof) for dof in dofs]
    names = [term.name for term in terms]
    inertia = np.array([names.index(ACCELERATIONS[column]) for column in columns])
    evaluated = np.any(support, axis=1)
    evaluated[inertia] = False
    axes, rows = np.nonzero(
        (support & evaluated[:, None]).T
    )  # axis after axis, terms in their order
    used, term = np.unique(rows, return_inverse=True)
    codes = basis.codes(terms)[used]
    index = [INDEX[VELOCITIES[column]] for column in columns]
    structure = PlantTable(
        codes=codes.astype(np.uint64),  # numba checks signed indices for negative values
        term=term.astype(np.uint64),
        first=np.searchsorted(axes, np.arange(len(dofs) + 1)).astype(np.int64),
        entries=np.zeros(len(rows)),
        inverse_inertia=np.zeros((len(dofs), len(dofs))),
        coupled=_coupling(support[inertia].T),
        velocity_index=np.array(index, dtype=np.uint64),
        magnitudes=np.array(
            [i for i in range(len(dofs)) if N_VARIABLES + index[i] in codes], np.uint64
        ),
        aerodynamic=bool(np.any(np.isin(codes % N_VARIABLES, [INDEX[name] for name in AIR]))),
        turning=has_coriolis(terms, dofs, support),
        speed=driven or bool(np.any(np.isin(codes % N_VARIABLES, [INDEX[name] for name in SPEED]))),
        sideslip=driven or bool(np.any(codes % N_VARIABLES == INDEX[SIDESLIP])),
        inputs=np.array([INDEX[name] for name in inputs], dtype=np.uint64),
        axes=np.array(columns, dtype=np.uint64),
        devices=NO_DEVICES.structures,
        parameters=NO_DEVICES.parameters,
    )
    return Layout(structure, rows, axes, inertia)


def has_coriolis(terms: Sequence[Term], dofs: Sequence[str], support: Flags) -> bool:
    """Whether a table has Coriolis forces, products of a velocity and an angular rate."""
    linear = [i for i, dof in enumerate(dofs) if dof in DOFS[:3]]
    products = {basis.term(a + b) for a in VELOCITIES[:3] for b in VELOCITIES[3:]}
    rows = [i for i, term in enumerate(terms) if term in products]
    return bool(np.any(support[np.ix_(rows, linear)]))


def _coupling(support: Flags) -> Flags:
    """Entries of M^-1 that can be non-zero: axes connected by entries of the inertia matrix."""
    linked = np.eye(len(support), dtype=bool) | support | support.T
    for _ in range(len(support)):
        linked = linked @ linked
    return linked
