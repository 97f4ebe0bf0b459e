"""A vessel is a coefficient table: the force a motion needs is linear in its coefficients.

    tau[dof] = sum_k theta[k, dof] phi_k(nu_dot, nu, attitude, nu_q)

In a current nu and nu_dot are velocity and acceleration through the water: in a uniform current a
vessel moves relative to the water as in still water. This holds for the rigid body too (Fossen
(2011), property 8.1), so a table does not separate rigid-body and hydrodynamic terms. Velocities
through the air, nu_q, are separate variables.

The nominal model, the true plant, a residual model and the improved model F1 = F0 + Theta Phi
(Jervan (2020), eq. (3.22)) are the same type; improving again is addition. Inverse dynamics
evaluates the table, forward dynamics solves its inertia columns for nu_dot.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np

from seatrial.models.compiled import lean_kernel
from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import (
    ACCELERATIONS,
    DOFS,
    FORCE_UNIT,
    VELOCITIES,
    accelerations_of,
    velocities_of,
)
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import AIR, INDEX, INPUTS, N_VARIABLES, SPEED, Array, Codes, Term
from seatrial.models.vessel.devices.device import Device, Installed, device_forces, installed
from seatrial.models.vessel.plant_table import Flags, Layout, PlantTable, has_coriolis, layout

Attitude = Literal["quaternion", "euler"]  # euler is singular at 90 degrees of pitch


class ForceTable(NamedTuple):
    """Inverse dynamics for the kernels: codes (n, 3), theta (n, n_dof), indices (n_dof,)."""

    codes: Codes
    theta: Array
    acceleration_index: Codes
    velocity_index: Codes
    aerodynamic: bool  # whether it has terms in the velocity through the air


@dataclass(frozen=True, eq=False)
class Vessel:
    """A coefficient table: rows are `terms`, columns `dofs`, entries `theta` in SI units."""

    name: str
    dofs: tuple[str, ...]
    terms: tuple[Term, ...]
    theta: Array  # shape (n_terms, n_dof), force per basis function
    attitude: Attitude = "quaternion"  # how six degrees of freedom are integrated
    inputs: tuple[str, ...] = ()  # names of the inputs; empty: forces are commanded
    devices: Mapping[str, Device] = field(default_factory=dict)  # that the inputs drive

    def __post_init__(self) -> None:
        unknown = [dof for dof in self.dofs if dof not in DOFS]
        if unknown:
            raise ConfigurationError(
                f"dofs: got {unknown[0]!r}, expected some of {', '.join(DOFS)}"
            )
        theta = np.array(self.theta, dtype=np.float64)
        if theta.shape != (len(self.terms), len(self.dofs)):
            raise ConfigurationError(
                f"theta: got shape {theta.shape}, expected ({len(self.terms)}, {len(self.dofs)})"
            )
        theta.setflags(write=False)
        missing = [n for d in self.devices.values() for n in d.inputs() if n not in self.inputs]
        if missing:
            raise ConfigurationError(
                f"inputs: got {', '.join(self.inputs) or 'none'}, but a device needs {missing[0]!r}"
            )
        object.__setattr__(self, "theta", theta)

    @property
    def velocities(self) -> tuple[str, ...]:
        """Letters of the body velocities, in the order of `dofs`."""
        return velocities_of(self.dofs)

    @property
    def accelerations(self) -> tuple[str, ...]:
        """Names of the accelerations, in the order of `dofs`."""
        return accelerations_of(self.dofs)

    @cached_property
    def codes(self) -> Codes:
        """Codes of the terms for the kernels, shape (n_terms, 3 to 6)."""
        return basis.codes(self.terms)

    @cached_property
    def inertia(self) -> Array:
        """M [kg, kg m, kg m^2], shape (n_dof, n_dof): the coefficients of the accelerations."""
        return np.array([self.row(name) for name in self.accelerations]).T

    @cached_property
    def _rows(self) -> dict[Term, int]:
        return {term: row for row, term in reversed([*enumerate(self.terms)])}

    def row(self, name: str) -> Array:
        """Coefficients of a term over `dofs`, shape (n_dof,); zero if it is not in the table."""
        row = self._rows.get(basis.term(name))
        return np.zeros(len(self.dofs)) if row is None else np.asarray(self.theta[row])

    def coefficient(self, dof: str, name: str) -> float:
        """Coefficient of a term in a degree of freedom, in SI units."""
        return float(self.row(name)[self.dofs.index(dof)])

    def variables(
        self,
        nu_dot: Array,
        nu: Array,
        attitude: Array | None = None,
        wind: Array | None = None,
        inputs: Array | None = None,
    ) -> Array:
        """Variables of sampled motion, shape (N, N_VARIABLES).

        attitude (phi, theta, psi) [rad], shape (N, 3), defaults to level and north, `wind`, the
        velocity of the air in body axes [m/s], shape (N, 2), to still air, and `inputs`, shape
        (N, n_inputs), to zero.
        """
        level = np.zeros((len(nu), 3)) if attitude is None else attitude
        named = {} if inputs is None else dict(zip(self.inputs, inputs.T, strict=True))
        return basis.variables(nu_dot, nu, level, self.dofs, wind, named)

    @cached_property
    def installed(self) -> Installed:
        """The devices for the kernels."""
        return installed(self.devices)

    @cached_property
    def forces_commanded(self) -> bool:
        """Whether the command is a force on each axis; otherwise it is a value of each input."""
        return not self.inputs

    @property
    def forces_known(self) -> bool:
        """Whether a force is known in absolute terms: it is commanded, or devices give it.

        Otherwise the equation of motion holds for any multiple of its coefficients, so that data
        determine them relative to the inertia only.
        """
        return self.forces_commanded or bool(self.devices)

    @cached_property
    def bare_hull(self) -> bool:
        """Whether the table is that of the hull alone, so that what moves it is known beside it.

        Forces are commanded, or devices give them and no term has an input or the speed U.
        """
        others = {*self.inputs, *basis.SPEED}
        variables = (
            basis.VARIABLES[code % basis.N_VARIABLES] for term in self.terms for code in term.codes
        )
        return self.forces_known and others.isdisjoint(variables)

    def inverse(
        self,
        nu_dot: Array,
        nu: Array,
        attitude: Array | None = None,
        wind: Array | None = None,
        inputs: Array | None = None,
    ) -> Array:
        """Force that the motion requires [N, Nm], shape (N, n_dof). Jervan (2020), eq. (2.10).

        With devices it is the force required beside theirs under the inputs (N, n_inputs).
        """
        x = self.variables(nu_dot, nu, attitude, wind, inputs)
        force = np.asarray(basis.evaluate_codes(self.codes, x) @ self.theta, dtype=np.float64)
        if not self.devices:
            return force
        made = device_forces(self.installed, x)
        return force - made[:, [DOFS.index(dof) for dof in self.dofs]]

    def forward(
        self,
        tau: Array,
        nu: Array,
        attitude: Array | None = None,
        wind: Array | None = None,
        inputs: Array | None = None,
    ) -> Array:
        """Acceleration under a force tau [N, Nm], shape (N, n_dof): M^-1 (tau - F(0, nu)).

        `inputs` (N, n_inputs) drive the devices.
        """
        rest = self.inverse(np.zeros_like(nu), nu, attitude, wind, inputs)
        return np.asarray(np.linalg.solve(self.inertia, (tau - rest).T).T, dtype=np.float64)

    def __add__(self, other: "Vessel") -> "Vessel":
        """Sum of the tables over the union of their terms. Jervan (2020), eq. (3.26)."""
        if other.dofs != self.dofs:
            raise ConfigurationError(f"cannot add a model of {other.dofs} to one of {self.dofs}")
        union = self.terms + tuple(term for term in other.terms if term not in self._rows)
        return replace(
            self,
            terms=union,
            theta=self.on(union).theta + other.on(union).theta,
            inputs=self.inputs + tuple(name for name in other.inputs if name not in self.inputs),
            devices={**other.devices, **self.devices},
        )

    def __mul__(self, factor: float) -> "Vessel":
        return replace(self, theta=factor * self.theta)

    __rmul__ = __mul__

    def __sub__(self, other: "Vessel") -> "Vessel":
        return self + (-1.0) * other

    def on(self, union: Sequence[Term]) -> "Vessel":
        """The same table with its rows in the order of `union`; rows not in it are dropped."""
        theta = np.zeros((len(union), len(self.dofs)))
        for i, term in enumerate(union):
            if term in self._rows:
                theta[i] = self.theta[self._rows[term]]
        return replace(self, terms=tuple(union), theta=theta)

    def unit(self, term: Term, dof: str) -> str:
        """SI unit of a coefficient (radians have none), such as kg, kg/s, kg/m, kg m^2, N."""
        return coefficient_unit(term, dof)

    def force_table(self) -> ForceTable:
        """The table for the kernels, without terms that are zero in every degree of freedom."""
        rows = [i for i in range(len(self.terms)) if np.any(self.theta[i] != 0.0)]
        return ForceTable(
            basis.codes([self.terms[i] for i in rows]),
            np.ascontiguousarray(self.theta[rows]),
            np.array([INDEX[name] for name in self.accelerations]),
            np.array([INDEX[name] for name in self.velocities]),
            self._has(rows, AIR),
        )

    def plant_table(self) -> PlantTable:
        """Forward dynamics for the kernels; computed once.

        Raises ConfigurationError if the inertia matrix is not positive definite or a product
        contains an acceleration: then nu_dot does not follow from a constant matrix.
        """
        return self._plant_table

    @cached_property
    def _plant_table(self) -> PlantTable:
        eigenvalues = np.linalg.eigvals(self.inertia)
        if np.min(eigenvalues.real) <= 0.0:
            raise ConfigurationError(
                f"{self.name}: the inertia matrix must be positive definite, "
                f"got an eigenvalue of {np.min(eigenvalues.real):.3g}"
            )
        accelerated = set(range(1, 1 + len(ACCELERATIONS)))
        for term, row in zip(self.terms, self.theta, strict=True):
            factors = {code % N_VARIABLES for code in term.codes}
            if factors & accelerated and term.name not in ACCELERATIONS and np.any(row != 0.0):
                raise ConfigurationError(f"{self.name}: term {term} cannot be solved for nu_dot")
        positions = self.layout(self.theta != 0.0)
        return positions.plant(
            self.theta, np.asarray(np.linalg.inv(self.inertia), dtype=np.float64)
        )

    def layout(self, support: Flags) -> Layout:
        """Positions of the coefficients that can be non-zero, shape (n_terms, n_dof)."""
        return layout(self.terms, self.dofs, support, self.inputs, self.installed)

    @property
    def turning(self) -> bool:
        """Whether the table has Coriolis forces."""
        return has_coriolis(self.terms, self.dofs, self.theta != 0.0)

    def _has(self, rows: Sequence[int], names: Sequence[str]) -> bool:
        """Whether any of the terms in `rows` contains one of the named variables."""
        indices = {INDEX[name] for name in names}
        return any(indices & {code % N_VARIABLES for code in self.terms[i].codes} for i in rows)


# Powers of metre and second in the unit of each variable
EXPONENTS = {
    **dict.fromkeys((*VELOCITIES[:3], *AIR, SPEED[0]), (1, -1)),
    **dict.fromkeys((*VELOCITIES[3:], *(n for n in INPUTS if n[0] == "n")), (0, -1)),
    **dict.fromkeys(ACCELERATIONS[:3], (1, -2)),
    **dict.fromkeys(ACCELERATIONS[3:], (0, -2)),
    SPEED[1]: (-1, 1),
    SPEED[2]: (-2, 2),
}


def coefficient_unit(term: Term, dof: str) -> str:
    """SI unit of the coefficient of a term in a degree of freedom; radians count as 1."""
    metres, seconds = (1, -2) if FORCE_UNIT[dof] == "N" else (2, -2)
    for code in term.codes:
        by_metres, by_seconds = EXPONENTS.get(basis.VARIABLES[code % N_VARIABLES], (0, 0))
        metres, seconds = metres - by_metres, seconds - by_seconds
    if (metres, seconds) in ((1, -2), (2, -2)):
        return "N" if metres == 1 else "Nm"
    numerator = ["kg"] + [_power(u, n) for u, n in (("m", metres), ("s", seconds)) if n > 0]
    factors = [_power(u, -n) for u, n in (("m", metres), ("s", seconds)) if n < 0]
    denominator = factors[0] if len(factors) == 1 else f"({' '.join(factors)})"
    return " ".join(numerator) + (f"/{denominator}" if factors else "")


def _power(unit: str, exponent: int) -> str:
    return unit if exponent == 1 else f"{unit}^{exponent}"


def fill_variables(z: Array, index: Codes, values: Array) -> None:
    """Write values and their magnitudes into z = [x, |x|] at the given variables."""
    half = z.shape[0] // 2
    for i in range(index.shape[0]):
        z[index[i]] = values[i]
        z[half + index[i]] = abs(values[i])


fill_variables_kernel = lean_kernel(fill_variables)
SPEED_Q, U_Q, V_Q = (INDEX[name] for name in AIR)


def fill_air(z: Array, ahead: float, aside: float) -> None:
    """Write the velocity through the air [m/s] and its norm, and their magnitudes, into z."""
    speed = np.sqrt(ahead * ahead + aside * aside)
    z[U_Q], z[V_Q], z[SPEED_Q] = ahead, aside, speed
    z[N_VARIABLES + U_Q], z[N_VARIABLES + V_Q] = abs(ahead), abs(aside)
    z[N_VARIABLES + SPEED_Q] = speed


fill_air_kernel = lean_kernel(fill_air)


def weighted_sum(theta: Array, phi: Array, out: Array) -> None:
    """out = theta' phi; theta (n, n_dof), phi (n,)."""
    for i in range(theta.shape[1]):
        total = 0.0
        for k in range(theta.shape[0]):
            total += theta[k, i] * phi[k]
        out[i] = total


weighted_sum_kernel = lean_kernel(weighted_sum)
