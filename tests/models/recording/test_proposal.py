"""Columns are recognised by their titles as loggers of many kinds write them."""
# ruff: noqa: E501

from pathlib import Path

import numpy as np
import pytest
import yaml

from seatrial.models.errors import RecordingError
from seatrial.models.recording.proposal import Proposal, propose
from seatrial.models.recording.source import Source, TextArray
from seatrial.models.vessel.basis import Array

# Of every logger the sources, columns as `title=signal` or `title=signal*factor`, and the map.
DEG, KNOT = "57.29578", "1.943844"
LOGGERS = {
    "plain": (
        "log: time=t; north=x; east=y; heading=psi; u=u; v=v; r=r; force_x=X; force_y=Y; moment_z=N",
        "{time: time, position: {surge: north, sway: east, yaw: heading},"
        " velocity: {surge: u, sway: v, yaw: r}, force: {surge: force_x, sway: force_y, yaw: moment_z}}",
    ),
    "units in titles": (
        f"log: stamp_s=t; north_m=x; east_m=y; hdg_deg=psi*{DEG}; spd_fwd_kn=u*{KNOT}; spd_stbd_kn=v*{KNOT};"
        f" rot_deg_min=r*3437.7; tau_x_kN=X*1e-3; tau_y_kN=Y*1e-3; moment_z_kNm=N*1e-3",
        "{time: stamp_s, position: {surge: north_m, sway: east_m, yaw: {column: hdg_deg, unit: deg}},"
        " velocity: {surge: {column: spd_fwd_kn, unit: knot}, sway: {column: spd_stbd_kn, unit: knot},"
        " yaw: {column: rot_deg_min, unit: deg/min}}, force: {surge: {column: tau_x_kN, unit: kN},"
        " sway: {column: tau_y_kN, unit: kN}, yaw: {column: moment_z_kNm, unit: kN*m}}}",
    ),
    "spaces and brackets": (
        f"log: Time (ms)=t*1e3; Pos North (m)=x; Pos East (m)=y; Yaw Angle (deg)=psi*{DEG}; Surge Speed (m/s)=u;"
        f" Sway Speed (m/s)=v; Yaw Rate (deg/s)=r*{DEG}; Rudder Angle (deg)=delta*{DEG}; Shaft Speed (rpm)=n*60",
        "{time: {column: Time (ms), unit: ms}, position: {surge: Pos North (m), sway: Pos East (m),"
        " yaw: {column: Yaw Angle (deg), unit: deg}}, velocity: {surge: Surge Speed (m/s),"
        " sway: Sway Speed (m/s), yaw: {column: Yaw Rate (deg/s), unit: deg/s}},"
        " inputs: {delta: {column: Rudder Angle (deg), unit: deg}, n: {column: Shaft Speed (rpm), unit: rpm}}}",
    ),
    "degrees by the motion": (
        f"log: t=t; x=x; y=y; roll=phi*{DEG}; pitch=theta*{DEG}; yaw=psi*{DEG}; u=u; v=v; r=r; tau_x=X; tau_y=Y; tau_n=N",
        "{time: t, position: {surge: x, sway: y, roll: {column: roll, unit: deg}, pitch: {column: pitch, unit: deg},"
        " yaw: {column: yaw, unit: deg}}, velocity: {surge: u, sway: v, yaw: r},"
        " force: {surge: tau_x, sway: tau_y, yaw: tau_n}}",
    ),
    "dataflash of an autopilot": (
        f"XKF1: TimeUS=t*1e6; Yaw=psi*{DEG}; VN=vn; VE=ve; PN=x; PE=y\n"
        f"ATT: TimeUS=t*1e6; Roll=phi*{DEG}; Pitch=theta*{DEG}; Yaw=psi*{DEG}; DesYaw=psi*{DEG}\n"
        "RCOU: TimeUS=t*1e6; C1=pwm; C2=1500; C3=pwm\nRCIN: TimeUS=t*1e6; C1=pwm\nIMU: TimeUS=t*1e6; GyrZ=r; T=T\n"
        f"GPS: TimeUS=t*1e6; Lat=lat; Lng=lon; Spd=sog; GCrs=cog*{DEG}\nBARO: TimeUS=t*1e6; Alt=T; Temp=T",
        "{time: {column: TimeUS, unit: us}, position: {surge: 'XKF1:PN', sway: 'XKF1:PE',"
        " roll: 'ATT:Roll', pitch: 'ATT:Pitch', yaw: {column: 'XKF1:Yaw', unit: deg}},"
        " velocity: {surge: 'XKF1:VN', sway: 'XKF1:VE', yaw: 'IMU:GyrZ'}, frames: {velocity: earth},"
        " inputs: {C1: 'RCOU:C1', C3: 'RCOU:C3'}}",
    ),
    "uORB": (
        "vehicle_local_position: timestamp=t*1e6; x=x; y=y; z=z; vx=vn; vy=ve; heading=psi; dist_bottom=T\n"
        "vehicle_local_position_setpoint: timestamp=t*1e6; x=T; y=T; yaw=T; vx=T\n"
        "vehicle_attitude: timestamp=t*1e6; q[0]=qw; q[1]=0; q[2]=0; q[3]=qz\n"
        "vehicle_angular_velocity: timestamp=t*1e6; xyz[0]=p; xyz[1]=q; xyz[2]=r\n"
        "actuator_outputs: timestamp=t*1e6; output[0]=pwm; output[1]=pwm",
        "{time: {column: timestamp, unit: us}, position: {surge: 'vehicle_local_position:x',"
        " sway: 'vehicle_local_position:y', heave: 'vehicle_local_position:z', yaw: 'vehicle_local_position:heading'},"
        " velocity: {surge: 'vehicle_local_position:vx', sway: 'vehicle_local_position:vy',"
        " roll: 'vehicle_angular_velocity:xyz[0]', pitch: 'vehicle_angular_velocity:xyz[1]',"
        " yaw: 'vehicle_angular_velocity:xyz[2]'},"
        " inputs: {'output[0]': 'actuator_outputs:output[0]', 'output[1]': 'actuator_outputs:output[1]'}}",
    ),
    "odometry and a wrench": (
        "odom: time=t; pose.pose.position.x=x; pose.pose.position.y=y; pose.pose.orientation.x=0;"
        " pose.pose.orientation.y=0; pose.pose.orientation.z=qz; pose.pose.orientation.w=qw; pose.covariance[0]=T;"
        " twist.twist.linear.x=u; twist.twist.linear.y=v; twist.twist.angular.z=r\n"
        "tau: time=t; wrench.force.x=X; wrench.force.y=Y; wrench.torque.z=N\n"
        "tau_ref: time=t; wrench.force.x=T; wrench.force.y=T; wrench.torque.z=T",
        "{time: time, orientation: {w: 'odom:pose.pose.orientation.w', x: 'odom:pose.pose.orientation.x',"
        " y: 'odom:pose.pose.orientation.y', z: 'odom:pose.pose.orientation.z'},"
        " position: {surge: 'odom:pose.pose.position.x', sway: 'odom:pose.pose.position.y'},"
        " velocity: {surge: 'odom:twist.twist.linear.x', sway: 'odom:twist.twist.linear.y',"
        " yaw: 'odom:twist.twist.angular.z'},"
        " force: {surge: 'tau:wrench.force.x', sway: 'tau:wrench.force.y', yaw: 'tau:wrench.torque.z'}}",
    ),
    "topics of a USV": (
        "imu/data: time=t; orientation.x=0; orientation.y=0; orientation.z=qz; orientation.w=qw; angular_velocity.z=r;"
        " linear_acceleration.x=T\ngps/fix: time=t; latitude=lat; longitude=lon; altitude=T; position_covariance[0]=T\n"
        "cmd_drive: time=t; left=T; right=delta\ngps/vel: time=t; twist.linear.x=vn; twist.linear.y=ve",
        "{time: time, orientation: {w: 'imu/data:orientation.w', x: 'imu/data:orientation.x',"
        " y: 'imu/data:orientation.y', z: 'imu/data:orientation.z'},"
        " geodetic: {latitude: 'gps/fix:latitude', longitude: 'gps/fix:longitude', altitude: 'gps/fix:altitude'},"
        " velocity: {surge: 'gps/vel:twist.linear.x', sway: 'gps/vel:twist.linear.y', yaw: 'imu/data:angular_velocity.z'},"
        " inputs: {left: 'cmd_drive:left', right: 'cmd_drive:right'}}",
    ),
    "thrusters by topic": (
        "odometry: time=t; position.x=x; position.y=y; yaw=psi\nthrusters/left_cmd: time=t; data=T\n"
        "thrusters/right_cmd: time=t; data=delta",
        "{time: time, position: {surge: 'odometry:position.x', sway: 'odometry:position.y', yaw: 'odometry:yaw'},"
        " inputs: {'thrusters/left_cmd:data': 'thrusters/left_cmd:data',"
        " 'thrusters/right_cmd:data': 'thrusters/right_cmd:data'}}",
    ),
    "yacht": (
        f"log: Utc=t; Lat=lat; Lon=lon; HDG=psi*{DEG}; COG=cog*{DEG}; SOG=sog*{KNOT}; BSP=stw*{KNOT}; Heel=phi*{DEG};"
        f" Trim=theta*{DEG}; TWS=tws*{KNOT}; TWD=twd*{DEG}; TWA=twd*{DEG}; AWS=tws*{KNOT}; AWA=T; Rudder=delta*{DEG}; ROT=r*{DEG}",
        "{time: Utc, geodetic: {latitude: Lat, longitude: Lon}, position: {roll: {column: Heel, unit: deg},"
        " pitch: {column: Trim, unit: deg}, yaw: {column: HDG, unit: deg}}, velocity: {yaw: ROT},"
        " ground: {speed: {column: SOG, unit: knot}, course: {column: COG, unit: deg}}, water: {speed: BSP},"
        " wind: {speed: TWS, direction: {column: TWD, unit: deg}}, inputs: {delta: Rudder}}",
    ),
    "true and relative wind": (
        "log: t=t; x=x; y=y; psi=psi; wind_velo_relative=tws; wind_dir_relative=T; wind_velo_true=tws; wind_dir_true=twd",
        "{time: t, position: {surge: x, sway: y, yaw: psi}, wind: {speed: wind_velo_true, direction: wind_dir_true}}",
    ),
    "data model of a boat": (
        "log: datetime=t; navigation.position.latitude=lat; navigation.position.longitude=lon;"
        " navigation.headingTrue=psi; navigation.headingMagnetic=T; navigation.courseOverGroundTrue=cog;"
        " navigation.speedOverGround=sog; navigation.speedThroughWater=stw; navigation.rateOfTurn=r;"
        " environment.wind.speedApparent=tws; environment.wind.angleApparent=twd; steering.rudderAngle=delta;"
        " propulsion.port.revolutions=n",
        "{time: datetime, geodetic: {latitude: navigation.position.latitude, longitude: navigation.position.longitude},"
        " position: {yaw: navigation.headingTrue}, velocity: {yaw: navigation.rateOfTurn},"
        " ground: {speed: navigation.speedOverGround, course: navigation.courseOverGroundTrue},"
        " water: {speed: navigation.speedThroughWater}, wind: {speed: environment.wind.speedApparent,"
        " direction: environment.wind.angleApparent, kind: apparent},"
        " inputs: {delta: steering.rudderAngle, n: propulsion.port.revolutions}}",
    ),
    "sentences": (
        f"RMC: time=t; latitude=lat; longitude=lon; spd_over_grnd=sog*{KNOT}; true_course=cog*{DEG}\n"
        f"HDT: time=t; heading=psi*{DEG}\nROT: time=t; rate_of_turn=r*3437.7\nMWV: time=t; wind_angle=twd*{DEG};"
        f" wind_speed=tws*{KNOT}\nVHW: time=t; heading_magnetic=T; water_speed_knots=stw*{KNOT}\nRSA: time=t; rudder=delta",
        "{time: time, geodetic: {latitude: 'RMC:latitude', longitude: 'RMC:longitude'},"
        " position: {yaw: {column: 'HDT:heading', unit: deg}}, velocity: {yaw: 'ROT:rate_of_turn'},"
        " ground: {speed: {column: 'RMC:spd_over_grnd', unit: knot}, course: 'RMC:true_course'},"
        " water: {speed: {column: 'VHW:water_speed_knots', unit: knot}},"
        " wind: {speed: 'MWV:wind_speed', direction: 'MWV:wind_angle', kind: apparent}, inputs: {delta: 'RSA:rudder'}}",
    ),
    "tags of a ship": (
        f"log: time=t; positioningsystem_latitude_deg=lat; positioningsystem_longitude_deg=lon;"
        f" positioningsystem_heading_deg_1=psi*{DEG}; positioningsystem_sog_kn_1=sog*{KNOT}; positioningsystem_cog_deg_1=cog*{DEG};"
        f" positioningsystem_stw_kn_1=stw*{KNOT}; anemometer_tws_mps_1=tws; anemometer_twd_deg_1=twd*{DEG};"
        f" rudder_angle_deg_1=delta*{DEG}; propeller_rpm_1=n*60; enginemain_power_kw_1=T",
        "{time: time, geodetic: {latitude: positioningsystem_latitude_deg, longitude: positioningsystem_longitude_deg},"
        " position: {yaw: {column: positioningsystem_heading_deg_1, unit: deg}},"
        " ground: {speed: {column: positioningsystem_sog_kn_1, unit: knot}, course: {column: positioningsystem_cog_deg_1, unit: deg}},"
        " water: {speed: {column: positioningsystem_stw_kn_1, unit: knot}},"
        " wind: {speed: anemometer_tws_mps_1, direction: {column: anemometer_twd_deg_1, unit: deg}},"
        " inputs: {delta: {column: rudder_angle_deg_1, unit: deg}, n: {column: propeller_rpm_1, unit: rpm}}}",
    ),
    "glider": (
        "log: m_present_time=t; m_x_lmc=x; m_y_lmc=y; m_depth=z; m_heading=psi; m_pitch=theta; m_roll=phi; c_heading=T;"
        " m_fin=delta; c_fin=T; sci_water_temp=T; m_water_pressure=T",
        "{time: m_present_time, position: {surge: m_x_lmc, sway: m_y_lmc, heave: m_depth, roll: m_roll, pitch: m_pitch,"
        " yaw: m_heading}, inputs: {m_fin: m_fin}}",
    ),
    "estimated state of an AUV": (
        "EstimatedState: timestamp=t; lat=T; x=x; y=y; z=z; phi=phi; theta=theta; psi=psi; u=u; v=v; w=w; vx=vn; vy=ve;"
        " vz=w; p=p; q=q; r=r; depth=z\nGpsFix: timestamp=t; lat=lat; lon=lon; cog=cog; sog=sog\nRpm: timestamp=t; value=n",
        "{time: timestamp, position: {surge: 'EstimatedState:x', sway: 'EstimatedState:y', heave: 'EstimatedState:z',"
        " roll: 'EstimatedState:phi', pitch: 'EstimatedState:theta', yaw: 'EstimatedState:psi'},"
        " velocity: {surge: 'EstimatedState:u', sway: 'EstimatedState:v', heave: 'EstimatedState:w',"
        " roll: 'EstimatedState:p', pitch: 'EstimatedState:q', yaw: 'EstimatedState:r'}, inputs: {n: 'Rpm:value'}}",
    ),
    "vectors of an AUV": (
        "state: time=t; pos.x=x; pos.y=y; pos.z=z; pos_rph.x=phi; pos_rph.y=theta; pos_rph.z=psi; rate_uvw.x=u;"
        " rate_uvw.y=v; rate_uvw.z=w; rate_pqr.x=p; rate_pqr.y=q; rate_pqr.z=r; rudder_angle=delta; elevator_angle=T",
        "{time: time, position: {surge: pos.x, sway: pos.y, heave: pos.z, roll: pos_rph.x, pitch: pos_rph.y, yaw: pos_rph.z},"
        " velocity: {surge: rate_uvw.x, sway: rate_uvw.y, heave: rate_uvw.z, roll: rate_pqr.x, pitch: rate_pqr.y, yaw: rate_pqr.z},"
        " inputs: {delta: rudder_angle, elevator_angle: elevator_angle}}",
    ),
    "matrices of three columns": (
        "log: t=t; eta[0]=x; eta[1]=y; eta[2]=psi; nu[0]=u; nu[1]=v; nu[2]=r; tau[0]=X; tau[1]=Y; tau[2]=N",
        "{time: t, position: {surge: 'eta[0]', sway: 'eta[1]', yaw: 'eta[2]'},"
        " velocity: {surge: 'nu[0]', sway: 'nu[1]', yaw: 'nu[2]'}, force: {surge: 'tau[0]', sway: 'tau[1]', yaw: 'tau[2]'}}",
    ),
    "matrices of six columns": (
        "log: t=t; eta_1=x; eta_2=y; eta_3=z; eta_4=phi; eta_5=theta; eta_6=psi; nu_1=u; nu_2=v; nu_3=w; nu_4=p; nu_5=q;"
        " nu_6=r; nu_dot_1=T; nu_dot_2=X; nu_dot_3=Y; nu_dot_4=N; nu_dot_5=T; nu_dot_6=T",
        "{time: t, position: {surge: eta_1, sway: eta_2, heave: eta_3, roll: eta_4, pitch: eta_5, yaw: eta_6},"
        " velocity: {surge: nu_1, sway: nu_2, heave: nu_3, roll: nu_4, pitch: nu_5, yaw: nu_6},"
        " acceleration: {surge: nu_dot_1, sway: nu_dot_2, heave: nu_dot_3, roll: nu_dot_4, pitch: nu_dot_5, yaw: nu_dot_6}}",
    ),
    "symbols of manoeuvring": (
        "log: t=t; x=x; y=y; psi=psi; u=u; v=v; r=r; u_dot=T; v_dot=T; r_dot=T; X=X; Y=Y; N=N",
        "{time: t, position: {surge: x, sway: y, yaw: psi}, velocity: {surge: u, sway: v, yaw: r},"
        " acceleration: {surge: u_dot, sway: v_dot, yaw: r_dot}, force: {surge: X, sway: Y, yaw: N}}",
    ),
    "velocities along the earth": (
        "log: t=t; pos_n=x; pos_e=y; psi=psi; vel_n=vn; vel_e=ve; yaw_rate=r; Fx=X; Fy=Y; Mz=N",
        "{time: t, position: {surge: pos_n, sway: pos_e, yaw: psi}, velocity: {surge: vel_n, sway: vel_e, yaw: yaw_rate},"
        " frames: {velocity: earth}, force: {surge: Fx, sway: Fy, yaw: Mz}}",
    ),
    "derivatives of the pose": (
        "log: t=t; x=x; y=y; psi=psi; x_dot=vn; y_dot=ve; psi_dot=r; delta=delta",
        "{time: t, position: {surge: x, sway: y, yaw: psi}, velocity: {surge: x_dot, sway: y_dot, yaw: psi_dot},"
        " frames: {velocity: earth}, inputs: {delta: delta}}",
    ),
    "messages of a ROV": (
        "ATTITUDE: time_boot_ms=t*1e3; roll=phi; pitch=theta; yaw=psi; rollspeed=p; pitchspeed=q; yawspeed=r\n"
        "LOCAL_POSITION_NED: time_boot_ms=t*1e3; x=x; y=y; z=z; vx=vn; vy=ve; vz=w\n"
        "SERVO_OUTPUT_RAW: time_boot_ms=t*1e3; servo1_raw=pwm; servo2_raw=pwm; servo3_raw=1500",
        "{time: {column: time_boot_ms, unit: ms}, position: {surge: 'LOCAL_POSITION_NED:x', sway: 'LOCAL_POSITION_NED:y',"
        " heave: 'LOCAL_POSITION_NED:z', roll: 'ATTITUDE:roll', pitch: 'ATTITUDE:pitch', yaw: 'ATTITUDE:yaw'},"
        " velocity: {surge: 'LOCAL_POSITION_NED:vx', sway: 'LOCAL_POSITION_NED:vy', heave: 'LOCAL_POSITION_NED:vz',"
        " roll: 'ATTITUDE:rollspeed', pitch: 'ATTITUDE:pitchspeed', yaw: 'ATTITUDE:yawspeed'}, frames: {velocity: earth},"
        " inputs: {servo1_raw: 'SERVO_OUTPUT_RAW:servo1_raw', servo2_raw: 'SERVO_OUTPUT_RAW:servo2_raw'}}",
    ),
    "quaternion with the real part last": (
        "log: t=t; x=x; y=y; q_0=0; q_1=0; q_2=qz; q_3=qw; tauX=X; tauY=Y; tauN=N",
        "{time: t, orientation: {w: q_3, x: q_0, y: q_1, z: q_2}, position: {surge: x, sway: y}, force: {surge: tauX, sway: tauY, yaw: tauN}}",
    ),
    "east, north and up": (
        "log: time=t; x_enu=y; y_enu=x; yaw=psi; surge_velocity=u; sway_velocity=v; yaw_velocity=r; rpm_port=n; rpm_stbd=T",
        "{time: time, position: {surge: x_enu, sway: y_enu, yaw: yaw}, velocity: {surge: surge_velocity, sway: sway_velocity,"
        " yaw: yaw_velocity}, frames: {position: ENU},"
        " inputs: {rpm_port: {column: rpm_port, unit: rpm}, rpm_stbd: {column: rpm_stbd, unit: rpm}}}",
    ),
}  # fmt: skip


def _signals() -> dict[str, Array]:
    """A vessel of 2 m/s that turns to both sides, at 5 Hz for 10 minutes."""
    t = np.arange(0.0, 600.0, 0.2)
    r = 0.06 * np.sin(0.05 * t) + 0.03 * np.sin(0.021 * t + 1.0)
    psi = np.concatenate([[0.0], np.cumsum(0.1 * (r[1:] + r[:-1]))]) + 0.3
    u, v = 2.0 + 0.3 * np.sin(0.03 * t), -0.5 * r
    vn, ve = u * np.cos(psi) - v * np.sin(psi), u * np.sin(psi) + v * np.cos(psi)
    x, y = (np.concatenate([[0.0], np.cumsum(0.1 * (d[1:] + d[:-1]))]) for d in (vn, ve))
    wave = {name: 0.1 * np.sin((0.3 + 0.1 * k) * t) for k, name in enumerate(
        ("phi", "theta", "p", "q", "w", "z", "delta"))}  # fmt: skip
    return {
        "t": t, "x": x, "y": y, "psi": psi % (2.0 * np.pi), "u": u, "v": v, "r": r, "vn": vn, "ve": ve, **wave,
        "lat": 59.0 + x / 111_195.0, "lon": 24.0 + y / 111_195.0 / np.cos(np.radians(59.0)),
        "qw": np.cos(0.5 * psi), "qz": np.sin(0.5 * psi), "sog": np.hypot(vn, ve), "stw": u,
        "cog": np.arctan2(ve, vn) % (2.0 * np.pi), "tws": 5.0 + u, "twd": 3.0 + r, "pwm": 1500.0 + 400.0 * np.sin(t),
        "n": 5.0 + u, "X": 500.0 * u, "Y": 400.0 * r, "N": 200.0 * r, "T": 30.0 + np.cos(0.01 * t),
    }  # fmt: skip


def _sources(text: str, units: dict[str, str] | None = None) -> dict[str, Source]:
    known = _signals()
    sources = {}
    for line in text.splitlines():
        name, _, titles = line.partition(": ")
        columns: dict[str, Array | TextArray] = {}
        for title, _, signal in (item.strip().partition("=") for item in titles.split(";")):
            signal_name, _, size = signal.partition("*")
            values = known.get(signal_name)
            values = np.full(len(known["t"]), float(signal_name)) if values is None else values
            columns[title] = values * float(size or 1.0)
        sources[name] = Source(name, Path("log.csv"), columns, units or {})
    return sources


@pytest.mark.parametrize("logger", LOGGERS)
def test_columns_of_a_logger(logger: str) -> None:
    text, expected = LOGGERS[logger]
    assert propose(_sources(text)).map == yaml.safe_load(expected)


def _said(titles: str, wanted: tuple[str, ...] = (), **units: str) -> Proposal:
    return propose(_sources(f"log: t=t; x=x; y=y; {titles}", units), wanted)


def test_inputs_have_the_names_of_the_vessel() -> None:
    acting = "psi=psi; RPM=n*60; Helm=delta; rudder_cmd=T; tau_x=X; thr_left=T; thr_right=pwm"
    assert _said(acting, ("delta", "n")).map["inputs"] == {"delta": "Helm", "n": {"column": "RPM", "unit": "rpm"}}
    assert "force" not in _said(acting, ("delta", "n")).map
    assert _said(acting, ("pwm_1", "pwm_2")).map["inputs"] == {"pwm_1": "thr_left", "pwm_2": "thr_right"}
    both = _said("psi=psi; n_prop=n; delta_rudder=delta", ("n", "delta")).map
    assert both["inputs"] == {"n": "n_prop", "delta": "delta_rudder"}
    assert _said("psi=psi; n_2=n; n_1=T", ("n_1", "n_2")).map["inputs"] == {"n_1": "n_1", "n_2": "n_2"}
    (question,) = _said("psi=psi; n_2=n; n_1=T", ("n",)).questions
    assert "which column is the input n of the vessel? (n_2, n_1)" in question
    (question,) = _said("psi=psi; delta=delta", ("delta", "n")).questions
    assert "which column is the input n of the vessel? (no column looks like it)" in question
    forces = _said(acting)
    assert "inputs" not in forces.map
    assert any(line.startswith("look like inputs") and "RPM" in line for line in forces.left_out)


@pytest.mark.parametrize(
    ("titles", "question"),
    [
        ("depth=z; roll=phi*572.9", "roll ranges from"),
        (f"psi=psi; rudder=delta*{DEG}", "rudder ranges from"),
        ("psi=psi; rpm_shaft=n; shaft=n*60", "shaft ranges from"),
        ("psi=psi; pwm_1=pwm", "width of a pulse"),
        ("heading_magnetic=psi", "magnetic heading"),
    ],
)  # fmt: skip
def test_what_the_range_makes_doubtful_is_asked(titles: str, question: str) -> None:
    proposal = _said(titles)
    assert any(question in line for line in proposal.questions)
    assert "0.0174" not in str(proposal.map)


def test_units_of_the_header_are_not_repeated_and_count_for_those_beside() -> None:
    proposal = _said(f"psi=psi*{DEG}; roll=phi*{DEG}; heave=z", psi="deg", heave="m")
    assert proposal.map["position"] == {
        "surge": "x", "sway": "y", "heave": "heave", "roll": {"column": "roll", "unit": "deg"}, "yaw": "psi"
    }  # fmt: skip
    assert not proposal.questions


def test_course_is_no_heading_and_what_is_left_out_is_named() -> None:
    sources = _sources("log: t=t; lat=lat; lon=lon; COG=cog; SOG=sog; STW=stw; note=0; engine_temp=T")
    columns = dict(sources["log"].columns)
    columns["SOG"] = np.where(np.arange(len(columns["SOG"])) < 3, np.nan, columns["SOG"])
    columns["state"] = np.array(["on"] * len(columns["SOG"]), dtype=np.object_)
    proposal = propose({"log": Source("log", Path("log.csv"), columns)})
    assert set(proposal.map) == {"time", "geodetic"}
    text = "\n".join(proposal.left_out)
    assert all(name in text for name in ("COG", "SOG", "STW", "note", "engine_temp", "state"))
    with pytest.raises(RecordingError, match="no column of time among"):
        propose({name: Source(name, Path("log"), {"x": columns["lat"]}) for name in "ab"})


@pytest.mark.parametrize(
    ("title", "line"),
    [("t", "t in s (no unit is stated)"), ("TimeUS", "TimeUS in us (title)"),
     ("elapsed", "elapsed_time in ms (header)"), ("stamp", "stamp in ms (by its numbers)")],
)  # fmt: skip
def test_where_the_time_is_known_from(title: str, line: str) -> None:
    name = "elapsed_time" if title == "elapsed" else title
    size = {"t": "1", "TimeUS": "1e6"}.get(title, "1e3")
    units = {name: "ms"} if title == "elapsed" else {}
    proposal = propose(_sources(f"log: {name}=t*{size}; x=x; y=y; psi=psi", units))
    assert proposal.sure[0] == f"time: {line}"


def test_cells_that_are_missing_are_counted() -> None:
    sources = _sources("log: t=t; x=x; y=y; psi=psi")
    sources["log"].columns["x"][:3] = np.nan
    proposal = propose(sources)
    assert proposal.map["position"] == {"surge": "x", "sway": "y", "yaw": "psi"}
    assert any("x (3 of 3000)" in line for line in proposal.left_out)
