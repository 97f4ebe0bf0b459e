"""The equation of motion of a stored model, for the templates of other languages.

    eta_dot = J(eta) nu,    nu_dot = M^-1 (tau - F(0, nu_r, attitude, nu_q))

as in `models/simulation/dynamics.py`, whose functions are called with symbols: terms and devices
are those of the simulation. A language is a table: the spelling of each operation, of an entry of
an argument, and of an assignment. What the templates say themselves is the classical Runge-Kutta
step and the step of lags and limits.
"""

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import jinja2
import numpy as np

from seatrial.models.elementary import where
from seatrial.models.notation import DOFS, FORCE_UNIT, POSE_UNIT, poses_of
from seatrial.models.simulation.symbolic_rates import Symbols, symbolic_rates
from seatrial.models.symbols import ENTRY, entries, evaluate, in_symbols
from seatrial.models.vessel.devices.device import input_bounds
from seatrial.models.vessel.kinematics import frame_of_quaternion, half_turns
from seatrial.models.vessel.pose import Kinematics, Quaternion, kinematics_of, normalise
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import FirstOrderLag, Input, SecondOrderLag
from seatrial.runner.export.stored_model import StoredModel

LONGEST_OPERAND = 60  # characters of an operand that is not assigned to a variable
ATOM, SIGN, PRODUCT, SUM, COMPARISON = range(5)  # how loosely the parts of a text are bound
OPERATORS = {
    "add": ("+", SUM), "subtract": ("-", SUM), "multiply": ("*", PRODUCT), "divide": ("/", PRODUCT),
    "less": ("<", COMPARISON), "less_equal": ("<=", COMPARISON),
    "greater": (">", COMPARISON), "greater_equal": (">=", COMPARISON),
}  # fmt: skip


class Text(NamedTuple):
    """An expression as text, and how loosely its parts are bound."""

    text: str
    binding: int = ATOM

    def within(self, binding: int) -> str:
        """The text as a part of another one."""
        return f"({self.text})" if self.binding > binding else self.text


class Language(NamedTuple):
    """How a language spells expressions."""

    functions: Mapping[str, str]  # with a name that differs from that in numpy
    where: str  # the format of a choice
    entry: str
    first: int  # index of the first entry
    variable: str  # the format of the definition of a variable
    assignment: str
    function: str = "{}"  # the format of the name of any other function


C = Language(
    {"absolute": "fabs", "arctan2": "atan2", "minimum": "fmin", "maximum": "fmax"},
    "({} ? {} : {})", "{}[{}]", 0, "const double {} = {};", "{} = {};",
)  # fmt: skip
MATLAB = Language(
    {"absolute": "abs", "arctan2": "atan2", "minimum": "min", "maximum": "max"},
    "where({}, {}, {})", "{}({})", 1, "{} = {};", "{} = {};",
)  # fmt: skip
PYTHON = Language({}, "np.where({}, {}, {})", "{}[{}]", 0, "{} = {}", "{} = {}", "np.{}")


def statements(language: Language, **outputs: Collection[Any]) -> list[str]:
    """Statements that write arrays: `outputs` are their symbols and numbers, by name.

    What is used several times, or is long, is assigned to a variable t1, t2, ... first.
    """
    lines: list[str] = []

    def apply(operation: str, operands: Sequence[Any], uses: int) -> Text:
        if operation == ENTRY:
            name, index = operands
            return Text(language.entry.format(name, index + language.first))
        found = _spelled(language, operation, [*map(_text, operands)])
        if uses == 1 and len(found.text) <= LONGEST_OPERAND:
            return found
        variable = f"t{len(lines) + 1}"
        lines.append(language.variable.format(variable, found.text))
        return Text(variable)

    values = evaluate([one for symbols in outputs.values() for one in symbols], apply)
    targets = [
        language.entry.format(name, i + language.first)
        for name, symbols in outputs.items()
        for i in range(len(symbols))
    ]
    return lines + [
        language.assignment.format(target, _text(value).text)
        for target, value in zip(targets, values, strict=True)
        if _text(value).text != target
    ]


def _text(value: Text | float) -> Text:
    """A number with every digit."""
    return value if isinstance(value, Text) else Text(repr(float(value)), SIGN * (value < 0.0))


def _spelled(language: Language, operation: str, operands: Sequence[Text]) -> Text:
    """An operation on texts; products and sums are read from the left, as they were computed."""
    if operation == "negative":
        return Text(f"-{operands[0].within(ATOM)}", SIGN)
    if operation == "where":
        return Text(language.where.format(*(operand.text for operand in operands)))
    if operation in OPERATORS:
        sign, binding = OPERATORS[operation]
        left, right = operands
        if binding == SUM and right.text.startswith("-") and right.binding < SUM:
            sign, right = "-" if sign == "+" else "+", Text(right.text[1:], right.binding)
        tighter = ATOM if right.text.startswith("-") else binding - 1
        return Text(f"{left.within(binding)} {sign} {right.within(tighter)}", binding)
    name = language.functions.get(operation, language.function.format(operation))
    return Text(f"{name}({', '.join(operand.text for operand in operands)})")


TEMPLATES = Path(__file__).parent / "templates"
LANGUAGES = {".c": C, ".m": MATLAB, ".py": PYTHON}  # by the ending of what is written


class Lag(NamedTuple):
    """Numbers of the lags and limits of what acts, one of each per force or input.

    A time constant of 0 is that of what follows its command immediately.
    """

    time_constant: Sequence[float]
    low: Sequence[float]
    high: Sequence[float]
    rate: Sequence[float]
    start: Sequence[float]
    oscillation: tuple[float, float] | None = None  # w [rad/s] and damping of a second-order lag

    @property
    def order(self) -> int:
        """How many states each axis has."""
        return 1 if self.oscillation is None else 2

    @property
    def direct(self) -> list[bool]:
        """Which axes follow their command immediately."""
        numbers = zip(self.time_constant, self.rate, strict=True)
        return [self.order == 1 and t == 0.0 and rate == np.inf for t, rate in numbers]

    def derivative(self) -> Symbols:
        """Rates of `acting` under `command` as expressions, (order * n,)."""
        n = len(self.start)
        command, acting = entries("command", n), entries("acting", n * self.order)
        limits = zip(self.low, command, self.high, strict=True)
        distance = np.array([_between(*one) for one in limits], dtype=object) - acting[:n]
        if self.oscillation is not None:
            w, d = self.oscillation
            return np.concatenate([acting[n:], w * (w * distance - 2.0 * d * acting[n:])])
        choose = in_symbols(where)
        return np.array([
            0.0 if direct
            else _between(-rate, each / time, rate) if time > 0.0
            else choose(each > 0.0, rate, choose(each < 0.0, -rate, 0.0))
            for each, direct, time, rate in zip(
                distance, self.direct, self.time_constant, self.rate, strict=True
            )
        ], dtype=object)  # fmt: skip


@dataclass(frozen=True)
class Equations:
    """What a template needs of a vessel."""

    vessel: Vessel
    thruster: SecondOrderLag | None
    source: str
    inputs: Mapping[str, Input] = field(default_factory=dict)

    @cached_property
    def kinematics(self) -> Kinematics:
        """The kinematics J."""
        return kinematics_of(self.vessel.dofs, self.vessel.attitude)

    @property
    def in_angles(self) -> "Equations":
        """The same equations with an attitude in angles."""
        return replace(self, vessel=replace(self.vessel, attitude="euler"))

    @property
    def quaternion(self) -> bool:
        """Whether the attitude is a unit quaternion."""
        return isinstance(self.kinematics, Quaternion)

    @property
    def n(self) -> int:
        """Number of degrees of freedom."""
        return len(self.vessel.dofs)

    @property
    def n_pose(self) -> int:
        """Number of integrated coordinates of the pose."""
        return self.n + self.quaternion

    @property
    def indices(self) -> list[int]:
        """The degrees of freedom among the six."""
        return [DOFS.index(dof) for dof in self.vessel.dofs]

    @property
    def commands(self) -> dict[str, str]:
        """What is commanded, the inputs or the forces by degree of freedom, with its unit."""
        if self.inputs:
            return {name: input_bounds(name).unit or "1" for name in self.inputs}
        return {dof: FORCE_UNIT[dof] for dof in self.vessel.dofs}

    @cached_property
    def lag(self) -> Lag | None:
        """Lags and limits; None if the force follows its command immediately."""
        if self.inputs:
            each = [*self.inputs.values()]
            return Lag(
                [one.time_constant_s or 0.0 for one in each],
                [one.low for one in each], [one.high for one in each],
                [one.rate_limit or np.inf for one in each], [one.start for one in each],
            )  # fmt: skip
        lag = self.thruster
        if lag is None:
            return None
        high = lag.amplitude_limit or (np.inf,) * self.n
        low = [-limit for limit in high]
        rate, zeros = lag.rate_limit or (np.inf,) * self.n, [0.0] * self.n
        if isinstance(lag, FirstOrderLag):
            return Lag([lag.time_constant_s] * self.n, low, high, rate, zeros)
        return Lag(zeros, low, high, rate, zeros, (lag.natural_frequency_rad_s, lag.damping))

    def rates(self, language: Language) -> list[str]:
        """Statements that write `eta_dot` and `nu_dot`."""
        eta_dot, nu_dot = symbolic_rates(self.kinematics, self.vessel.plant_table())
        return statements(language, eta_dot=[*eta_dot], nu_dot=[*nu_dot])

    def changes(self, language: Language) -> list[str]:
        """Statements that write `acting_dot`."""
        return statements(language, acting_dot=[*self.lag.derivative()] if self.lag else [])

    def attitude(self, language: Language) -> dict[str, list[str]]:
        """Statements between the unit quaternion of a state and the angles of a pose."""
        eta, frame = entries("eta", 7), np.zeros((3, 3), dtype=object)
        in_symbols(frame_of_quaternion)(eta[3:], frame)
        level = np.sqrt(frame[2, 1] * frame[2, 1] + frame[2, 2] * frame[2, 2])
        angles = (
            np.arctan2(frame[2, 1], frame[2, 2]), np.arctan2(-frame[2, 0], level),
            np.arctan2(frame[1, 0], frame[0, 0]),
        )  # fmt: skip
        pose, unit = entries("pose", 6), entries("eta", 7)
        in_symbols(normalise)(self.kinematics, unit)
        return {
            "start": statements(language, eta=[*pose[:3], *half_turns(*pose[3:])]),
            "pose": statements(language, pose=[*eta[:3], *angles]),
            "unit": statements(language, eta=[*unit]),
        }

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
            language=LANGUAGES.get(Path(template).suffix), commands=self.commands,
            pose_units=[POSE_UNIT[dof] for dof in dofs],
            source=re.sub(r"[^\w .,:;=()|^+-]", "_", self.source), **more,
        )  # fmt: skip


def equations_of(model: StoredModel) -> Equations:
    """The equations of a stored model with the lags and limits of its vessel."""
    vessel = model.parameters
    return Equations(vessel.nominal(), vessel.thruster, model.source, vessel.inputs)


def _between(low: float, value: Any, high: float) -> Any:
    """A value within limits."""
    above = value if low == -np.inf else np.maximum(value, low)
    return above if high == np.inf else np.minimum(above, high)


def _matrix(values: Sequence[Sequence[float]], indent: int = 4) -> str:
    """Rows of a matrix, one a line, with every digit."""
    rows = (", ".join(repr(float(value)) for value in row) for row in values)
    return f",\n{' ' * indent}".join(f"[{row}]" for row in rows)
