"""A coefficient table laid out for the prediction kernels.

All candidates of a fit share which entries of the table can be other than zero; the kernels walk
only these. A term is the product of three rows of a work array

    z = [1, nu, |nu|, cos(eta_1), sin(eta_1), cos(eta_2), ..., u_q, v_q, V_q, |u_q|, |v_q|]

of shape (6 + 4 n_dof,).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import DOFS, PLANAR, VELOCITIES, poses_of, velocities_of
from seatrial.models.vessel.basis import AIR, ATTITUDE, N_VARIABLES, VARIABLES, Array, Codes, Term

Integrator = Literal["euler", "rk4"]
Flags = NDArray[np.bool_]
IN_AXES, IN_PLANE, IN_SPACE = range(3)  # each axis alone; (x, y, psi); (x, y, z, phi, theta, psi)


class Structure(NamedTuple):
    """What all candidates share, for the kernels."""

    factors: Codes  # (n_terms, 3) rows of z
    first: Codes  # (n_terms + 1,) first entry of each term
    axis: Codes  # (n_entries,) force axis of each entry
    coupled: Flags  # (n_dof, n_dof): entries of M^-1 that can be other than zero
    magnitudes: Codes  # velocities whose magnitude is used
    angles: Codes  # poses whose cosine and sine are used
    air: Codes  # velocities along surge and sway, -1 for none; empty where no term is in the air
    kinematics: int  # IN_AXES, IN_PLANE or IN_SPACE
    rk4: bool
    drag: Codes  # (n_entries,) coefficient of `one_axis` that each entry is; empty: it is none


@dataclass(frozen=True, eq=False)
class Layout:
    """The structure of a table, and where its entries stand in the table."""

    structure: Structure
    rows: Codes  # (n_entries,) term of each entry
    inertia: Codes  # (n_dof,) terms that are the accelerations

    def entries(self, tables: Array) -> Array:
        """Coefficients that the kernels walk, (n_entries, n), of tables (n, n_terms, n_dof)."""
        return np.ascontiguousarray(tables[:, self.rows, self.structure.axis].T)

    def inverse_inertia(self, tables: Array) -> tuple[Array, Flags]:
        """M^-1 of many tables, shape (n_dof, n_dof, n), and which of them are realistic.

        A table is realistic when its inertia is positive definite (kinetic energy); the others
        get a zero inverse, which stands still.
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


def size_of_z(n_dof: int) -> int:
    """Rows of the work array."""
    return 6 + 4 * n_dof


def layout(
    terms: Sequence[Term], dofs: tuple[str, ...], support: Flags, integrator: Integrator
) -> Layout:
    """Layout of tables over `terms`; support (n_terms, n_dof) is what can be other than zero."""
    n = len(dofs)
    accelerations = [f"{name}_dot" for name in velocities_of(dofs)]
    names = [one.name for one in terms]
    inertia = np.array([names.index(name) for name in accelerations])
    factors, rows, axes, first = [], [], [], [0]
    for row, one in enumerate(terms):
        if one.name in accelerations or not np.any(support[row]):
            continue
        found = _rows_of_z(one, dofs)
        if found is None:
            continue
        factors.append(found)
        columns = np.flatnonzero(support[row]).tolist()
        rows += [row] * len(columns)
        axes += columns
        first.append(len(rows))
    used = {row for three in factors for row in three}
    kinematics = {PLANAR: IN_PLANE, DOFS: IN_SPACE}.get(dofs, IN_AXES)
    turning: dict[int, set[int]] = {IN_AXES: set(), IN_PLANE: {2}, IN_SPACE: {3, 4, 5}}
    angles = {i for i in range(n) if {1 + 2 * n + 2 * i, 2 + 2 * n + 2 * i} & used}
    horizontal = [dofs.index(dof) if dof in dofs else -1 for dof in ("surge", "sway")]
    airborne = any(row > 4 * n for row in used)
    structure = Structure(
        factors=np.array(factors, dtype=np.int64).reshape(-1, 3),
        first=np.array(first),
        axis=np.array(axes, dtype=np.int64),
        coupled=_coupling(support[inertia].T),
        magnitudes=np.array([i for i in range(n) if 1 + n + i in used], dtype=np.int64),
        angles=np.array(sorted(angles | turning[kinematics]), dtype=np.int64),
        air=np.array(horizontal if airborne else [], dtype=np.int64),
        kinematics=kinematics,
        rk4=integrator == "rk4",
        drag=np.array(drag_of_one_axis(factors) if n == 1 else [], dtype=np.int64),
    )
    return Layout(structure, np.array(rows, dtype=np.int64), inertia)


def drag_of_one_axis(factors: Sequence[tuple[int, ...]]) -> list[int]:
    """Which coefficient each term is of a polynomial of the speed, see `one_axis`.

    c_0 to c_3 are those of u^0 to u^3, c_4 to c_6 those of |u|, |u|u and |u|u^2. Empty where a term
    has other factors than 1, u and |u|, rows 0 to 2 of z.
    """
    if any(row > 2 for rows in factors for row in rows):
        return []
    powers = [sum(row > 0 for row in rows) for rows in factors]
    odd = [rows.count(2) % 2 for rows in factors]  # |u|^2 is u^2
    return [3 + power if magnitude else power for power, magnitude in zip(powers, odd, strict=True)]


def _rows_of_z(one: Term, dofs: tuple[str, ...]) -> tuple[int, ...] | None:
    """Rows of z of a term's three factors; None for a velocity that the vessel does not have."""
    n, velocities, poses = len(dofs), velocities_of(dofs), poses_of(dofs)
    rows = []
    for code in one.codes:
        name, magnitude = VARIABLES[code % N_VARIABLES], code >= N_VARIABLES
        if name in VELOCITIES:
            if name not in velocities:
                return None
            rows.append(1 + velocities.index(name) + n * magnitude)
        elif name in ATTITUDE and not magnitude and name[4:-1] in poses:
            rows.append(1 + 2 * n + 2 * poses.index(name[4:-1]) + name.startswith("sin"))
        elif name in AIR:
            air = ("u_q", "v_q", "V_q").index(name)
            rows.append(1 + 4 * n + air + (3 if magnitude and name != "V_q" else 0))
        elif code == 0:
            rows.append(0)
        else:
            raise ConfigurationError(f"term {one} cannot be predicted in {', '.join(dofs)}")
    return tuple(rows)


def _coupling(support: Flags) -> Flags:
    """Entries of M^-1 that can be other than zero: axes that a chain of inertia connects."""
    linked = np.eye(len(support), dtype=bool) | support | support.T
    for _ in range(len(support)):
        linked = linked @ linked
    return linked
