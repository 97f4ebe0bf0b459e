"""Configuration of a vessel: derivatives, thrusters, limits and tuning values."""

from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Annotated, Literal

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import DOFS, PLANAR
from seatrial.models.ranges import Length, Positive, check_ranges
from seatrial.models.vessel.allocation import Allocation, DeviceAllocation, device_allocation
from seatrial.models.vessel.basis import INPUTS, N_VARIABLES, VARIABLES, Array
from seatrial.models.vessel.derivatives import CoriolisForces, Prime, RigidBody, from_derivatives
from seatrial.models.vessel.devices.device import Device, input_bounds
from seatrial.models.vessel.scales import Scales, scales
from seatrial.models.vessel.steering import Nomoto, SteeringModel, steady_speed, steering_model
from seatrial.models.vessel.table import Attitude, Vessel
from seatrial.models.vessel.thruster import Input, SecondOrderLag
from seatrial.models.vessel.tuning import FromVessel, Tuning

LARGEST_CONDITION = 1e15  # of an inertia matrix, that an inverse in 64 bits bears


@dataclass(frozen=True)
class Plant:
    """The true vessel of a simulation with its thrusters and limits."""

    vessel: Vessel
    thruster: SecondOrderLag | None
    velocity_limits: tuple[float, ...]  # [m/s, rad/s]
    change: tuple[float, Vessel] | None = None  # time [s] from which another vessel replaces it
    integrator: Literal["rk4", "euler"] = "rk4"
    # of the commanded force to the thrusters, or to the inputs of devices
    allocation: Allocation | DeviceAllocation | None = None
    inputs: tuple[Input, ...] = ()  # limits and lags of the inputs, as in the table

    @property
    def planar(self) -> bool:
        """Whether the pose is (x, y, psi) in NED; otherwise each axis integrates its velocity."""
        return self.vessel.dofs == PLANAR

    @property
    def immediate(self) -> tuple[str, ...]:
        """The axes or inputs that follow their command at once."""
        if not self.inputs:
            return self.vessel.dofs if self.thruster is None else ()
        named = zip(self.vessel.inputs, self.inputs, strict=True)
        return tuple(name for name, each in named if each.immediate)

    def at(self, time_s: float) -> Vessel:
        """The vessel from a time [s] on."""
        if self.change is None or time_s < self.change[0] - 1e-9:
            return self.vessel
        return self.change[1]


@dataclass(frozen=True)
class VesselParameters:
    """The configured parameters of a vessel.

    `tuning` holds values that other groups take from the vessel, such as gains, noise levels and
    force amplitudes; what it leaves out is derived from inertia, drag, `force_limits` and
    `length_m` (seatrial.models.vessel.derivation). `sources` states the source of the numbers of
    every other entry.
    """

    name: str
    dofs: tuple[str, ...]
    inertia: tuple[tuple[float, ...], ...] | None  # [kg, kg m, kg m^2]
    derivatives: dict[str, float]  # hydrodynamic derivatives, SI
    # [m/s, rad/s]; a simulation that exceeds one has diverged
    velocity_limits: Annotated[tuple[float, ...] | None, FromVessel("velocity_limits")] = None
    coriolis: CoriolisForces = True  # mmg: without the Munk moment
    plant_scale: float = 1.0
    thruster: SecondOrderLag | None = None
    tuning: Tuning = field(default_factory=Tuning)
    body: RigidBody | None = None  # instead of `inertia`: with weight and buoyancy
    force_limits: tuple[float, ...] | None = None  # [N, Nm] of the thrusters; None: unlimited
    length_m: Length | None = None  # of the hull; None: estimated from the inertia
    beam_m: Positive | None = None  # of the hull; None: a third of its length
    thrusters: Allocation | None = None  # thruster geometry and allocation method
    attitude: Attitude = "quaternion"  # of six degrees of freedom
    integrator: Literal["rk4", "euler"] = "rk4"  # of the simulation
    parameters: str | None = None  # name of the parameter set that completes the derivatives
    parameter_sets: dict[str, dict[str, float]] = field(default_factory=dict)
    sources: dict[str, str] = field(default_factory=dict)
    regressed_on: tuple[str, ...] = ()  # recordings, such as runs/turn*.csv, that numbers are from
    standard_errors: dict[str, float] = field(default_factory=dict)  # of derivatives; not sailed
    inputs: dict[str, Input] = field(default_factory=dict)  # what is commanded instead of forces
    devices: dict[str, Device] = field(default_factory=dict)  # in the order of their flow
    prime: Prime | None = None  # scales of derivatives without dimension
    restoring: dict[str, float] = field(default_factory=dict)  # derivatives in SI units, as K_phi
    speed_m_s: Positive | None = None  # of an approach; None: the steady one

    def __post_init__(self) -> None:
        check_ranges(self)
        check_dofs(self.dofs)
        unknown = [name for name in self.sources if name not in self.__dataclass_fields__]
        if unknown:
            raise ConfigurationError(
                f"sources.{unknown[0]}: got a source of an option that a vessel does not have"
            )
        if (self.parameters is None) == bool(self.parameter_sets) or (
            self.parameters is not None and self.parameters not in self.parameter_sets
        ):
            raise ConfigurationError(
                f"parameters: got {self.parameters}, expected one of "
                f"{', '.join(self.parameter_sets) or 'null'}"
            )
        for option in ("velocity_limits", "force_limits"):
            limits = getattr(self, option)
            if limits is not None and (len(limits) != len(self.dofs) or min(limits) <= 0.0):
                raise ConfigurationError(
                    f"{option} must be {len(self.dofs)} positive numbers, got {list(limits)}"
                )
        limited = self.force_limits is not None and self.positioning is None
        if self.inputs and (self.thruster or self.thrusters or limited):
            raise ConfigurationError(
                "inputs: got thruster, thrusters or force_limits as well, which are for a vessel "
                "that is commanded by forces"
            )
        for key in (key for key in self.inputs if key in INPUTS):
            for end in ("low", "high"):
                value = getattr(self.inputs[key], end)
                input_bounds(key).check(f"inputs.{key}.{end}", value)
        if self.thruster is not None:
            self.thruster.check(self.dofs)
        if self.thrusters is not None:
            self.thrusters.matrix(self.dofs)
        if (self.inertia is None) == (self.body is None):
            raise ConfigurationError("inertia and body: expected exactly one of them")
        if self.inertia is not None:
            check_inertia(self.inertia, len(self.dofs))
        for name in self.parameter_sets or (None,):  # those that are not chosen as well
            nominal = self._nominal if name == self.parameters else self._with_parameters(name)
            check_condition("inertia, with the added mass,", nominal.inertia)
            nominal.plant_table()

    def nominal(self) -> Vessel:
        """The nominal model F0; made once."""
        return self._nominal

    @cached_property
    def _nominal(self) -> Vessel:
        return self._with_parameters(self.parameters)

    def _with_parameters(self, name: str | None) -> Vessel:
        """The nominal model with a set of parameters."""
        rows = [DOFS.index(dof) for dof in self.dofs]
        if self.body is not None:
            inertia = self.body.inertia()[np.ix_(rows, rows)]
        else:
            inertia = np.array(self.inertia, dtype=np.float64)
        derivatives = self.derivatives | self.parameter_sets.get(name or "", {})
        if self.prime is not None:
            inertia = self.prime.inertia_matrix(inertia, self.dofs)
            derivatives = self.prime.dimensional(derivatives)
        restored = {key: derivatives.get(key, 0.0) + v for key, v in self.restoring.items()}
        derivatives = derivatives | restored
        table = from_derivatives(self.name, self.dofs, inertia, derivatives, self.coriolis)
        table = table if self.body is None else table + self.body.restoring(self.dofs)
        for term in table.terms:
            factors = {VARIABLES[code % N_VARIABLES] for code in term.codes}
            if lacking := factors & {*INPUTS} - {*self.inputs}:
                expected = f"expected one of the inputs ({', '.join(self.inputs) or 'none'})"
                raise ConfigurationError(f"derivatives: got {min(lacking)}, {expected}")
        if self.attitude == table.attitude and not self.inputs and not self.devices:
            return table
        return replace(
            table, attitude=self.attitude, inputs=tuple(self.inputs), devices=self.devices
        )

    def plant(self, table: Vessel) -> Plant:
        """The plant with a coefficient table and the thrusters and limits of this vessel."""
        return Plant(
            table,
            self.thruster,
            self.velocity_limits or self.scales.velocity_limits,
            integrator=self.integrator,
            allocation=self.thrusters,
            inputs=tuple(self.inputs.values()),
        )

    @cached_property
    def scales(self) -> Scales:
        """Scales of length, force and speed; raises ConfigurationError if too little is given."""
        limits = self.limits_by_dof
        known = tuple(limits[dof] for dof in self.dofs) if limits else None
        return scales(self.nominal(), known, self.length_m)

    @cached_property
    def positioning(self) -> DeviceAllocation | None:
        """The allocation of forces to the devices; None if the inputs cannot give any force."""
        return device_allocation(self.devices, self.inputs, self.dofs)

    @property
    def limits_by_dof(self) -> dict[str, float]:
        """Largest force of the thrusters [N, Nm] by degree of freedom, if it is known."""
        given = self.force_limits
        if given is None and self.positioning is not None:
            given = self.positioning.limits(self.dofs)
        limits = dict(zip(self.dofs, given or (), strict=False))
        lag = None if self.thruster is None else self.thruster.amplitude_limit
        for dof, limit in zip(self.dofs, lag or (), strict=False):
            limits[dof] = min(limit, limits.get(dof, np.inf))
        return limits

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the inputs; empty for a vessel that is commanded by forces."""
        return tuple(self.inputs)

    @property
    def helm(self) -> str:
        """The rudder angle `delta`, else the first input; empty without inputs."""
        return "delta" if "delta" in self.inputs else next(iter(self.inputs), "")

    @cached_property
    def steered_by(self) -> str | tuple[str, str]:
        """The input that an autopilot turns the vessel with, or two, by their difference.

        It is `delta`, else two inputs that drive the vessel ahead together, else the rudder
        `delta_...` that turns it most.
        """
        rudders = [i for i, name in enumerate(self.inputs) if name.startswith("delta_")]
        alone = "delta" in self.inputs or not (rudders or len(self.inputs) == 2)
        if alone or self._ahead is None:
            return "delta"
        if self._ahead.differential:
            first, second = self.inputs
            return first, second
        turning = np.abs(self._ahead.B[self.dofs.index("yaw")])
        return self.input_names[max(rudders, key=lambda i: turning[i])] if rudders else "delta"

    @property
    def driven_by(self) -> str | tuple[str, str] | None:
        """The input that an autopilot holds the speed with, `n`, or two, by their sum."""
        if "n" in self.inputs:
            return "n"
        return None if isinstance(self.steered_by, str) else self.steered_by

    @property
    def input_start(self) -> tuple[float, ...]:
        """Values of the inputs before the first command."""
        return tuple(each.start for each in self.inputs.values())

    @cached_property
    def approach_speed_m_s(self) -> float:
        """Speed ahead [m/s] at the start of the inputs: `speed_m_s`, or the steady one."""
        if self.speed_m_s is not None:
            return self.speed_m_s
        limits = self.velocity_limits or self.scales.velocity_limits
        highest = limits[self.dofs.index("surge")]
        return steady_speed(self.nominal(), np.array(self.input_start), highest)

    @cached_property
    def _ahead(self) -> SteeringModel | None:
        """The linearised motion at the approach; None without inputs or yaw."""
        if not self.inputs or "yaw" not in self.dofs:
            return None
        return steering_model(
            self.nominal(), self.approach_speed_m_s, np.array(self.input_start, dtype=np.float64)
        )

    @cached_property
    def undamped(self) -> tuple[str, ...]:
        """Axes on which nothing opposes half the attainable speed, at the approach if there is one.

        Tables about a straight course leave out what the propeller balances: there, not surge.
        """
        dofs, inertia = self.dofs, self.nominal().inertia
        moving, straight = 0.5 * np.diag(self.scales.speeds), np.zeros_like(inertia)
        if self.inputs and "surge" in dofs:
            straight[:, dofs.index("surge")] = self.approach_speed_m_s
        force = [self.nominal().inverse(0.0 * straight, nu) for nu in (straight + moving, straight)]
        drag = zip(dofs, np.diag(force[0] - force[1]), strict=True)
        return tuple(dof for dof, n in drag if n <= 0.0 and not (self.inputs and dof == "surge"))

    @property
    def input_signs(self) -> tuple[float, ...]:
        """Sign of the yaw acceleration by each input at the approach; 1 for one without any."""
        return (1.0,) * len(self.inputs) if self._ahead is None else self._ahead.signs

    @property
    def nomoto_gain(self) -> tuple[float, ...]:
        """Gain K [1/s] of the yaw rate over each input at the approach; 0 for one without any."""
        return tuple(each.gain for each in self._nomotos)

    @property
    def nomoto_time_s(self) -> tuple[float, ...]:
        """Time constant T [s] of the yaw rate over each input at the approach."""
        return tuple(each.time_s for each in self._nomotos)

    @cached_property
    def _nomotos(self) -> tuple[Nomoto, ...]:
        """The first-order models of the inputs; zeros for one that does not turn the vessel."""
        none = (Nomoto(0.0, 0.0),) * len(self.inputs)
        return none if self._ahead is None else self._ahead.nomotos

    @property
    def input_low(self) -> tuple[float, ...]:
        """Smallest values of the inputs."""
        return tuple(each.low for each in self.inputs.values())

    @property
    def input_high(self) -> tuple[float, ...]:
        """Largest values of the inputs."""
        return tuple(each.high for each in self.inputs.values())

    @property
    def input_rates(self) -> tuple[float | None, ...]:
        """Largest changes of the inputs in a second; None: unlimited."""
        return tuple(each.rate_limit for each in self.inputs.values())

    @property
    def input_lags(self) -> tuple[float | None, ...]:
        """Time constants of the inputs [s]; None: they follow at once."""
        return tuple(each.time_constant_s for each in self.inputs.values())

    @property
    def planar(self) -> bool:
        """Whether the vessel moves in surge, sway and yaw."""
        return self.dofs == PLANAR


def check_dofs(dofs: tuple[str, ...]) -> None:
    """Raise ConfigurationError unless these are different degrees of freedom."""
    unknown = [dof for dof in dofs if dof not in DOFS]
    if unknown or not dofs or len(set(dofs)) < len(dofs):
        shown = unknown[0] if unknown else ", ".join(dofs) or "none"
        raise ConfigurationError(f"dofs: got {shown}, expected different ones of {', '.join(DOFS)}")


def check_inertia(rows: tuple[tuple[float, ...], ...], n: int) -> None:
    """Raise ConfigurationError unless an inertia matrix is (n, n), finite and regular."""
    lengths = [len(row) for row in rows]
    if lengths != [n] * n:
        raise ConfigurationError(
            f"inertia: got rows of {', '.join(map(str, lengths)) or 'no'} numbers, "
            f"expected {n} rows of {n}"
        )
    check_condition("inertia", np.array(rows, dtype=np.float64))


@lru_cache(maxsize=64)
def _condition(content: bytes, n: int) -> float:
    """Condition number of an (n, n) matrix; a trial builds its vessel several times."""
    with np.errstate(all="ignore"):
        return float(np.linalg.cond(np.frombuffer(content).reshape(n, n)))


def check_condition(name: str, matrix: Array) -> None:
    """Raise ConfigurationError for a matrix that is not finite or nearly singular."""
    if not np.all(np.isfinite(matrix)):
        raise ConfigurationError(f"{name} must be finite, got {matrix.tolist()}")
    condition = _condition(matrix.tobytes(), len(matrix))
    if not condition <= LARGEST_CONDITION:
        raise ConfigurationError(
            f"{name} has a condition number of {condition:.1e}, expected at most "
            f"{LARGEST_CONDITION:g}"
        )
