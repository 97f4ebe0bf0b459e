"""The weather that a vessel meets in one trial, realised at every control instant."""

from typing import NamedTuple

import numpy as np

from seatrial.models.vessel.basis import Array


class Weather(NamedTuple):
    """Realised disturbances, one row a control instant; SI units. What is absent has no rows."""

    pose_noise: Array  # (N, n_dof), added to the measured pose
    velocity_noise: Array  # (N, n_dof)
    acceleration_noise: Array  # (N, n_dof), in the log only
    force_ned: Array  # (N, n_dof), NED [N, N, Nm]; along the axis where there is no heading
    current_ned: Array = np.zeros((0, 2))  # (N, 2) velocity of the water, north and east
    wind_ned: Array = np.zeros((0, 2))  # (N, 2) velocity of the air
    wind_noise: Array = np.zeros((0, 2))  # (N, 2), added to the measured wind, body axes
    process: Array = np.zeros((0, 0))  # (N, n_dof) accelerations [m/s^2, rad/s^2]
    wind_body: Array = np.zeros((0, 2))  # (N, 2) velocity of the air in body axes, as recorded
    wave_motion: Array = np.zeros((0, 0))  # (N, n_dof), the part of pose_noise that waves make
