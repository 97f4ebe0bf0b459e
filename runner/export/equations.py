"""The equation of motion of a stored model, for the templates of other languages.

    eta_dot = J(eta) nu,    nu_dot = M^-1 (tau - F(0, nu_r, attitude, nu_q))

as in `models/simulation/dynamics.py`. The non-zero terms of the table are listed axis by axis, in
the order in which our kernels add them.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import jinja2
import numpy as np

from seatrial.models.notation import FORCE_UNIT, POSE_UNIT, poses_of
from seatrial.models.vessel.basis import N_VARIABLES, VARIABLES
from seatrial.models.vessel.parameters import VesselParameters
from seatrial.models.vessel.pose import Axes, Kinematics, Quaternion, kinematics_of
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import FirstOrderLag, SecondOrderLag
from seatrial.runner.export.stored_model import StoredModel

TEMPLATES = Path(__file__).parent / "templates"


@dataclass(frozen=True)
class Product:
    """A coefficient times variables, some of them as magnitudes; no variable: a constant."""

    coefficient: float
    factors: tuple[tuple[str, bool], ...]  # name of a variable, and whether its magnitude counts

    def spelled(self, magnitude: str) -> str:
        """The product with its sign, in languages in which `magnitude` is the function |x|."""
        sign = "-" if np.signbit(self.coefficient) else "+"
        names = [f"{magnitude}({name})" if absolute else name for name, absolute in self.factors]
        number = repr(abs(self.coefficient))
        if not names:
            return f"{sign} {number}"
        text = " * ".join(names)
        return f"{sign} {number} * {f'({text})' if names[1:] else text}"


@dataclass(frozen=True)
class Equations:
    """What a template needs of a vessel."""

    vessel: Vessel
    thruster: SecondOrderLag | None
    source: str

    @cached_property
    def kinematics(self) -> Kinematics:
        """The kinematics J."""
        return kinematics_of(self.vessel.dofs, self.vessel.attitude)

    @property
    def kind(self) -> str:
        """Name of the kinematics: axes, planar, quaternion or euler."""
        return type(self.kinematics).__name__.lower()

    @property
    def axes(self) -> dict[str, int]:
        """Index of each axis of independent axes (north, east, roll, pitch, yaw), -1 for none."""
        return self.kinematics._asdict() if isinstance(self.kinematics, Axes) else {}

    @property
    def n(self) -> int:
        """Number of degrees of freedom."""
        return len(self.vessel.dofs)

    @property
    def n_pose(self) -> int:
        """Number of integrated coordinates of the pose."""
        return self.n + isinstance(self.kinematics, Quaternion)

    @property
    def turning(self) -> bool:
        """Whether a current rotates in body axes as the vessel turns."""
        return self.vessel.plant_table().turning

    @property
    def aerodynamic(self) -> bool:
        """Whether there are terms in the velocity through the air."""
        return self.vessel.plant_table().aerodynamic

    @cached_property
    def forces(self) -> tuple[tuple[Product, ...], ...]:
        """The terms without acceleration of each axis."""
        plant = self.vessel.plant_table()
        return tuple(
            tuple(
                Product(float(plant.entries[k]), _factors(plant.codes[plant.term[k]]))
                for k in range(plant.first[i], plant.first[i + 1])
            )
            for i in range(self.n)
        )

    @cached_property
    def used(self) -> frozenset[str]:
        """The variables that occur in the terms."""
        products = (product for axis in self.forces for product in axis)
        return frozenset(name for product in products for name, _ in product.factors)

    @property
    def inverse_inertia(self) -> list[list[tuple[int, float]]]:
        """Column and value of the entries of each row of M^-1 that couple axes."""
        plant = self.vessel.plant_table()
        return [
            [(j, float(plant.inverse_inertia[i, j])) for j in range(self.n) if plant.coupled[i, j]]
            for i in range(self.n)
        ]

    @property
    def lag(self) -> dict[str, Any] | None:
        """The numbers of the thrusters' lag; None if the force follows its command at once."""
        lag = self.thruster
        if lag is None:
            return None
        limits = {"amplitude": lag.amplitude_limit, "rate": lag.rate_limit}
        if isinstance(lag, FirstOrderLag):
            return {"order": 1, "time_constant": lag.time_constant_s, **limits}
        w, d = lag.natural_frequency_rad_s, lag.damping
        return {"order": 2, "w": w, "d": d, "damped": w * abs(1.0 - d * d) ** 0.5, **limits}

    def render(self, template: str, **more: object) -> str:
        """Fill in a template of the folder `templates`."""
        environment = jinja2.Environment(
            loader=jinja2.FileSystemLoader(TEMPLATES), undefined=jinja2.StrictUndefined,
            trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True,
        )  # fmt: skip
        environment.filters |= {"number": lambda value: repr(float(value)), "matrix": _matrix}
        dofs = self.vessel.dofs
        return environment.get_template(f"{template}.jinja").render(
            eq=self, dofs=dofs, letters=self.vessel.velocities, poses=poses_of(dofs),
            force_units=[FORCE_UNIT[dof] for dof in dofs],
            pose_units=[POSE_UNIT[dof] for dof in dofs],
            source=re.sub(r"[^\w .,:;=()|^+-]", "_", self.source), **more,
        )  # fmt: skip


def equations_of(model: StoredModel) -> Equations:
    """The equations of a stored model with the lag of its vessel's thrusters."""
    vessel: VesselParameters = model.parameters
    return Equations(vessel.nominal(), vessel.thruster, model.source)


def _factors(codes: Sequence[int]) -> tuple[tuple[str, bool], ...]:
    """Names of the variables of a term; `cos(psi)` is named cos_psi."""
    return tuple(
        (VARIABLES[code % N_VARIABLES].replace("(", "_").replace(")", ""), code >= N_VARIABLES)
        for code in map(int, codes)
        if code % N_VARIABLES
    )


def _matrix(values: Sequence[Sequence[float]], indent: int = 4) -> str:
    """Rows of a matrix, one a line, with every digit."""
    rows = (", ".join(repr(float(value)) for value in row) for row in values)
    return f",\n{' ' * indent}".join(f"[{row}]" for row in rows)
