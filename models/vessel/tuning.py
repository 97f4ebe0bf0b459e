"""Numbers that other parts of a trial take from the vessel, and how an option asks for one.

Every entry that a vessel does not give is derived (seatrial.models.vessel.derivation).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, is_dataclass
from functools import cache
from typing import Annotated, Any, get_args, get_origin, get_type_hints

from seatrial.models.ranges import NotNegative, Positive, PositiveInt, check_ranges

AUTO = "auto"  # value of an option that is taken from the vessel


@dataclass(frozen=True)
class FromVessel:
    """Annotation of an option that is taken from the vessel where it is left out or `auto`.

    `name` is the path of the number in the vessel, such as `tuning.pid.kp`, or a function of the
    other options of the same object that returns it. With `entry`, only this entry of a mapping is
    taken from the vessel, where it is `auto`.

        kp: Annotated[tuple[float, ...], FromVessel("tuning.pid.kp")]
    """

    name: str | Callable[[Mapping[str, object]], str]
    entry: str | None = None

    def path(self, options: Mapping[str, object]) -> str:
        """The path of the number in the vessel."""
        return self.name if isinstance(self.name, str) else self.name(options)


@dataclass(frozen=True)
class Marks:
    """The options of a class that are taken from the vessel, and its parts of fixed classes."""

    marks: Mapping[str, FromVessel]
    parts: Mapping[str, type]  # classes of the options whose nodes need no `_target_`


@cache
def marks_of(cls: type) -> Marks:
    """The marks of a dataclass, by option."""
    marks: dict[str, FromVessel] = {}
    parts: dict[str, type] = {}
    for name, hint in get_type_hints(cls, include_extras=True).items():
        declared, *metadata = get_args(hint) if get_origin(hint) is Annotated else (hint,)
        for kind in (declared, *get_args(declared)):
            if isinstance(kind, type) and is_dataclass(kind):
                parts[name] = kind
        for mark in metadata:
            if isinstance(mark, FromVessel):
                marks[name] = mark
    return Marks(marks, parts)


@dataclass(frozen=True)
class Group:
    """Numbers of a vessel; None: derived."""

    def __post_init__(self) -> None:
        check_ranges(self)


@dataclass(frozen=True)
class PidTuning(Group):
    """Gains of the PID controller, by degree of freedom."""

    kp: tuple[float, ...] | None = None  # [N/m, Nm/rad]
    ki: tuple[float, ...] | None = None  # [N/(m s), Nm/(rad s)]
    kd: tuple[float, ...] | None = None  # [N s/m, Nm s/rad]


@dataclass(frozen=True)
class ReferenceTuning(Group):
    """Moving set-points between way-points, and the filter of set-points."""

    interval_s: Positive | None = None
    speed_m_s: Positive | None = None
    turn_rate_rad_s: Positive | None = None
    bandwidth_rad_s: Positive | None = None


@dataclass(frozen=True)
class ExcitationTuning(Group):
    """Sizes and durations of excitations."""

    time_scale: Positive | None = None  # factor by which signals are slowed down
    amplitude: dict[str, float] | None = None  # [N, Nm] by degree of freedom
    surge_force_n: float | None = None  # of zig-zag and turning circle
    yaw_moment_nm: float | None = None
    approach_s: NotNegative | None = None
    manoeuvre_s: Positive | None = None
    velocity_scale: Positive | None = None  # of runs at constant velocity
    run_s: Positive | None = None
    rest_s: Positive | None = None


@dataclass(frozen=True)
class ConstantForceTuning(Group):
    """A constant force in NED."""

    north_n: float | None = None
    east_n: float | None = None
    moment_nm: float | None = None


@dataclass(frozen=True)
class NoiseTuning(Group):
    """Standard deviations of the measurement noise."""

    position_m: NotNegative | None = None
    angle_deg: NotNegative | None = None
    velocity_m_s: NotNegative | None = None
    angular_rate_deg_s: NotNegative | None = None
    acceleration_m_s2: NotNegative | None = None
    angular_acceleration_deg_s2: NotNegative | None = None
    wind_m_s: NotNegative | None = None


@dataclass(frozen=True)
class WindTuning(Group):
    """Mean wind and the time constant of its gusts."""

    speed_m_s: NotNegative | None = None
    time_constant_s: Positive | None = None


@dataclass(frozen=True)
class CurrentTuning(Group):
    """Mean current, its standard deviation and its largest speed."""

    speed_m_s: NotNegative | None = None
    deviation_m_s: NotNegative | None = None
    max_m_s: Positive | None = None


@dataclass(frozen=True)
class WavesTuning(Group):
    """Standard deviations of the motion in waves, and their peak period."""

    position_m: NotNegative | None = None
    heading_deg: NotNegative | None = None
    peak_period_s: Positive | None = None


@dataclass(frozen=True)
class MissionTuning(Group):
    """Positioning missions with limited speed and acceleration."""

    side_m: Positive | None = None
    square_s: Positive | None = None  # duration of the square
    four_corner_s: Positive | None = None
    speed: tuple[Positive, ...] | None = None  # [m/s, rad/s]
    acceleration: tuple[Positive, ...] | None = None  # [m/s^2, rad/s^2]


@dataclass(frozen=True)
class ControlTuning(Group):
    """Weights of the linear controllers and of their Kalman filter."""

    period_s: Positive | None = None  # sampling period of the commands
    horizon: PositiveInt | None = None  # in samples
    error_weight: tuple[float, ...] | None = None  # [1/m^2, 1/rad^2]
    input_weight: tuple[float, ...] | None = None  # on force / limit
    increment_weight: tuple[float, ...] | None = None  # on increment per sample / limit
    process: tuple[float, ...] | None = None  # [m/s^2, rad/s^2]
    measurement: tuple[float, ...] | None = None  # [m, rad]
    bias_walk: tuple[float, ...] | None = None  # change of the disturbance in 1 s [N, Nm]
    mission: MissionTuning = field(default_factory=MissionTuning)


@dataclass(frozen=True)
class Tuning(Group):
    """All values; those that are None are derived. `windage` is a wind force, null: none."""

    pid: PidTuning = field(default_factory=PidTuning)
    reference: ReferenceTuning = field(default_factory=ReferenceTuning)
    excitation: ExcitationTuning = field(default_factory=ExcitationTuning)
    constant_force: ConstantForceTuning = field(default_factory=ConstantForceTuning)
    noise: NoiseTuning = field(default_factory=NoiseTuning)
    windage: Any = AUTO
    wind: WindTuning = field(default_factory=WindTuning)
    current: CurrentTuning = field(default_factory=CurrentTuning)
    waves: WavesTuning = field(default_factory=WavesTuning)
    process: tuple[NotNegative, ...] | None = None  # white accelerations [m/s^2, rad/s^2]
    control: ControlTuning = field(default_factory=ControlTuning)
