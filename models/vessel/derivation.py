"""The tuning of a vessel, derived from its inertia, drag, thrust limits and length.

PID gains are placed by Fossen (2021), section 15.3.4: Kp = omega^2 M, Kd = 2 zeta omega M - D and
Ki = (omega / INTEGRAL) Kp. Linear-quadratic weights follow Bryson's rule for the error, and for the
input the weight that gives a vessel without drag the bandwidth omega,

    q e^2 + rho (tau / limit)^2:                rho = q (limit / M)^2 / omega^4
    q e^2 + rho (Delta tau / limit)^2 in h s:   rho = q (limit / M)^2 / (omega^6 h^2)

The bandwidth is a Froude number, omega sqrt(L / g): at most what the thrusters can follow with
their limits and their lag. The fractions below were set once, for all vessels of `conf/vessel`.
"""

from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, TypeVar

import numpy as np

from seatrial.models.notation import PLANAR, ROLLING
from seatrial.models.vessel import tuning as tunings
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.parameters import VesselParameters
from seatrial.models.vessel.scales import Scales
from seatrial.models.vessel.tuning import AUTO, Tuning

T = TypeVar("T")
DERIVED_DIGITS = 4  # of a derived number

# Bandwidth: omega sqrt(L / g); omega times the delay of the thrusters; error with full thrust
PID_BANDWIDTH, PID_LAG = 0.3, 0.35
LINEAR_BANDWIDTH, LINEAR_LAG, INCREMENT_LAG = 0.27, 0.25, 0.18
SATURATION = 0.01, 0.02  # [L, rad]
DAMPING_RATIO = 0.8
INTEGRAL = 10.0

PERIOD, HORIZON = 0.15, 6.0  # of linear controllers, in units of 1 / omega
ERROR = 0.02, 0.05  # acceptable error, for Bryson's rule [L, rad]
PROCESS, BIAS_WALK = 0.15, 0.01  # of the Kalman filter: of limit / M, and of the limit

REFERENCE_BANDWIDTH = 0.35  # omega sqrt(L / g) of the filter of set-points
CRUISE, TURN = 0.25, 0.2  # of the attainable speed, for missions; between way-points up to twice
SETTLING = 10.0  # time to settle at a set-point, in units of 1 / omega
LEG_M = 22.0  # longest leg of the way-points of conf/excitation/waypoints.yaml
LAP_BANDWIDTH = 0.3  # [rad/s] of the vessel for which the signals of conf/excitation were chosen

CONSTANT_FORCE = 0.1, 0.05  # constant force north and east, of the limits
# Measurement noise: of L, of sqrt(g L), of g; angles, of sqrt(g / L), of g / L; of the wind's speed
POSITION, SPEED, ACCELERATION = 0.004, 0.005, 5e-4
ANGLE_DEG, RATE, ANGULAR_ACCELERATION, WIND = 0.2, 0.002, 5e-4, 0.05
FRONTAL, LATERAL = 0.1, 0.2  # wind areas, of L^2
WIND_LOAD, WIND_SPEED, GUSTS = 0.2, 0.7, 25.0  # of the sway limit, of sqrt(g L), of sqrt(L / g)
CURRENT, CURRENT_DEVIATION = 0.02, 0.3  # of sqrt(g L), of the current
WAVES, WAVES_DEG, WAVE_PERIOD = 0.01, 1.0, 4.0  # of L, and of sqrt(L / g)
PROCESS_NOISE = 0.01  # of limit / M


def derived(vessel: VesselParameters, sample_time_s: float) -> dict[str, object]:
    """Limits and tuning of a vessel, by name, with every number that it leaves out derived.

    `sample_time_s` is the period of the loop, of which the controllers' period is a multiple.
    Raises ConfigurationError if the vessel has neither `force_limits` nor `length_m`.
    """
    scales, given = vessel.scales, vessel.tuning
    speeds = vessel.velocity_limits or scales.velocity_limits
    limits = vessel.force_limits or tuple(scales.limits.tolist())
    lag = vessel.thruster
    bands = Bandwidths(scales, 0.0 if lag is None else lag.delay_s)
    noise_and_wind = _weather(scales, given, vessel.dofs in (PLANAR, ROLLING))
    reference = _merged(given.reference, _reference(scales, bands))
    tuning = replace(
        noise_and_wind,
        pid=_pid(scales, bands, vessel),
        reference=reference,
        excitation=_excitation(scales, bands),
        control=_control(scales, bands, noise_and_wind.noise, sample_time_s),
    )
    numbers = {"velocity_limits": speeds, "tuning": tuning}
    if not vessel.inputs or vessel.positioning:  # the limits of inputs are their own
        numbers["force_limits"] = limits
    rounded = {name: _rounded(value) for name, value in numbers.items()}
    return {name: _merged(getattr(vessel, name), value) for name, value in rounded.items()}


@dataclass(frozen=True, eq=False)
class Bandwidths:
    """Closed-loop bandwidths [rad/s] by degree of freedom, and that of the set-points."""

    scales: Scales
    delay_s: float  # of the thrusters

    def of(self, froude: float, lag: float) -> Array:
        """omega, shape (n_dof,): limited by the lag, and by full thrust at a small error."""
        scales = self.scales
        largest = froude / scales.time_s
        if self.delay_s > 0.0:
            largest = min(largest, lag / self.delay_s)
        error = scales.each(SATURATION[0] * scales.length_m, SATURATION[1])
        return np.minimum(largest, np.sqrt(scales.acceleration / error))

    @property
    def pid(self) -> Array:
        """Of the PID controller."""
        return self.of(PID_BANDWIDTH, PID_LAG)

    @property
    def linear(self) -> Array:
        """Of linear controllers that weigh the force."""
        return self.of(LINEAR_BANDWIDTH, LINEAR_LAG)

    @property
    def increment(self) -> Array:
        """Of linear controllers that weigh increments of the force."""
        return self.of(LINEAR_BANDWIDTH, INCREMENT_LAG)

    @property
    def slowest(self) -> float:
        """The slowest of the linear controllers' axes."""
        return float(np.min(self.linear))


def _pid(scales: Scales, bands: Bandwidths, vessel: VesselParameters) -> tunings.PidTuning:
    omega = bands.pid
    model = vessel.nominal()
    drag = [
        max(model.coefficient(dof, u), 0.0)
        for dof, u in zip(model.dofs, model.velocities, strict=True)
    ]
    kp = omega**2 * scales.inertia
    kd = np.maximum(2.0 * DAMPING_RATIO * omega * scales.inertia - np.array(drag), 0.0)
    return tunings.PidTuning(_tuple(kp), _tuple(omega / INTEGRAL * kp), _tuple(kd))


def _reference(scales: Scales, bands: Bandwidths) -> tunings.ReferenceTuning:
    linear = scales.speeds[~scales.angular]
    ahead = float(np.append(linear, scales.speed_m_s)[0])
    speed = min(CRUISE * ahead, 2.0 * CRUISE * float(np.min(linear, initial=ahead)))
    turn = 2.0 * TURN * (scales.of("yaw", scales.speeds) or 1.0 / scales.time_s)
    legs = max(LEG_M / speed, np.pi / turn)
    return tunings.ReferenceTuning(
        interval_s=legs + SETTLING / bands.slowest,
        speed_m_s=speed,
        turn_rate_rad_s=turn,
        bandwidth_rad_s=min(REFERENCE_BANDWIDTH / scales.time_s, 2.0 * bands.slowest),
    )


def _excitation(scales: Scales, bands: Bandwidths) -> tunings.ExcitationTuning:
    slower = LAP_BANDWIDTH / bands.slowest
    force = np.clip(scales.drag, 0.05 * scales.limits, 0.5 * scales.limits)
    # The runs of conf/excitation/constant_velocity.yaml reach 0.3 m/s and 0.6 rad/s.
    fastest = scales.each(0.3 / CRUISE, 0.6 / (2.0 * CRUISE))
    return tunings.ExcitationTuning(
        time_scale=slower,
        amplitude=dict(zip(scales.dofs, force.tolist(), strict=True)),
        surge_force_n=scales.of("surge", force),
        yaw_moment_nm=0.5 * scales.of("yaw", force),
        approach_s=30.0 * slower,
        manoeuvre_s=300.0 * slower,
        velocity_scale=float(np.min(scales.speeds / fastest)),
        run_s=15.0 * slower,
        rest_s=15.0 * slower,
    )


def _weather(scales: Scales, given: Tuning, floats: bool) -> Tuning:
    """Noise and weather; only a vessel that floats has windage."""
    length, speed = scales.length_m, scales.speed_m_s
    sway = scales.of("sway", scales.limits)
    area = LATERAL * length**2
    wind_m_s = min(WIND_SPEED * speed, float(np.sqrt(WIND_LOAD * sway / (0.5 * 1.23 * 0.8 * area))))
    current = CURRENT * speed
    wind = _merged(given.wind, tunings.WindTuning(wind_m_s, GUSTS * scales.time_s))
    rate, angular = RATE / scales.time_s, ANGULAR_ACCELERATION / scales.time_s**2
    noise = tunings.NoiseTuning(
        position_m=POSITION * length,
        angle_deg=ANGLE_DEG,
        velocity_m_s=SPEED * speed,
        angular_rate_deg_s=float(np.degrees(rate)),
        acceleration_m_s2=ACCELERATION * speed / scales.time_s,
        angular_acceleration_deg_s2=float(np.degrees(angular)),
        wind_m_s=WIND * (wind.speed_m_s or 0.0),
    )
    return Tuning(
        constant_force=tunings.ConstantForceTuning(
            CONSTANT_FORCE[0] * scales.of("surge", scales.limits), CONSTANT_FORCE[1] * sway, 0.0
        ),
        noise=_merged(given.noise, noise),
        windage=_windage(length) if floats else None,
        wind=wind,
        current=tunings.CurrentTuning(
            current, CURRENT_DEVIATION * current, max(1.0, 2.0 * current)
        ),
        waves=tunings.WavesTuning(WAVES * length, WAVES_DEG, WAVE_PERIOD * scales.time_s),
        process=_tuple(PROCESS_NOISE * scales.acceleration),
    )


def _windage(length_m: float) -> dict[str, object]:
    """The node of a wind force, whose class is above this folder."""
    return {
        "_target_": "seatrial.models.weather.wind.Windage",
        "frontal_area_m2": FRONTAL * length_m**2,
        "lateral_area_m2": LATERAL * length_m**2,
        "length_m": length_m,
        "cx": 0.6,  # these as in Bargouth (2022), Table 2.3
        "cy": 0.8,
        "cn": 0.1,
        "air_density_kg_m3": 1.23,
    }


def _control(
    scales: Scales, bands: Bandwidths, noise: tunings.NoiseTuning, sample_time_s: float
) -> tunings.ControlTuning:
    rows = max(1, round(PERIOD / float(np.max(bands.linear)) / sample_time_s))
    period = rows * sample_time_s
    error = scales.each(1.0 / (ERROR[0] * scales.length_m) ** 2, 1.0 / ERROR[1] ** 2)
    force = error * scales.acceleration**2
    angle = float(np.radians(noise.angle_deg or 0.0))
    measured = np.maximum(scales.each(noise.position_m or 0.0, angle), 1e-6)
    return tunings.ControlTuning(
        period_s=period,
        horizon=max(10, round(HORIZON / bands.slowest / period)),
        error_weight=_tuple(error),
        input_weight=_tuple(force / bands.linear**4),
        increment_weight=_tuple(force / (bands.increment**6 * period**2)),
        process=_tuple(PROCESS * scales.acceleration),
        measurement=_tuple(measured),
        bias_walk=_tuple(BIAS_WALK * scales.limits),
        mission=_mission(scales, bands),
    )


def _mission(scales: Scales, bands: Bandwidths) -> tunings.MissionTuning:
    speed = scales.each(CRUISE, TURN) * scales.speeds
    acceleration = PROCESS * scales.acceleration
    side = 3.0 * scales.length_m
    way = scales.each(side, 0.5 * np.pi)  # along each axis between two poses
    leg = float(np.max(way / speed + speed / acceleration)) + SETTLING / bands.slowest
    return tunings.MissionTuning(side, 9.0 * leg, 6.0 * leg, _tuple(speed), _tuple(acceleration))


def _tuple(values: Array) -> tuple[float, ...]:
    return tuple(np.asarray(values).tolist())


def _merged(given: T, derived: T) -> T:
    """What is given, and what is derived where nothing is given."""
    if isinstance(given, tunings.Group):
        names = [entry.name for entry in fields(given)]
        return replace(given, **{n: _merged(getattr(given, n), getattr(derived, n)) for n in names})
    return derived if given is None or given == AUTO else given


def _rounded(value: Any) -> Any:
    """A derived number of DIGITS digits, or a structure of such numbers."""
    if isinstance(value, float):
        return float(f"{value:.{DERIVED_DIGITS}g}")
    if isinstance(value, tuple):
        return tuple(map(_rounded, value))
    if isinstance(value, dict):
        return {name: _rounded(item) for name, item in value.items()}
    if is_dataclass(value) and not isinstance(value, type):
        return replace(value, **{e.name: _rounded(getattr(value, e.name)) for e in fields(value)})
    return value
