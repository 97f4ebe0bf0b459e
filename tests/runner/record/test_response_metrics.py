"""The metrics of a deployment, worked out by hand from six instants."""

import numpy as np
import pytest

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.notation import PLANAR
from seatrial.models.simulation.voyage import Log, Voyage
from seatrial.models.weather.weather import Weather
from seatrial.runner.trials import deployment_metrics
from seatrial.runner.trials.closed_loop import ControlDesign, SimulatedMission

N, H = 6, 0.5


def sailed() -> SimulatedMission:
    """Six instants of three axes; what is not set is zero."""
    log = Log(*(np.zeros((N, 3)) for _ in Log._fields))
    log.eta_d[:, 0] = 3.0
    log.setpoint[:, 0] = [0.0, 0.0, 3.0, 3.0, 3.0, 3.0]
    log.eta[:, 0] = [1.0, 1.0, 3.0, 4.0, 3.0, 3.0]  # error 2, 2, 0, -1, 0, 0
    log.eta[:, 2] = np.radians([350.0, 0.0, 0.0, 0.0, 0.0, 0.0])  # 10 deg off, the short way
    log.tau[:, 0] = [0.0, 100.0, -100.0, 50.0, 0.0, 0.0]
    log.tau[:, 2] = [0.0, 0.0, 8.0, 0.0, 0.0, 0.0]
    log.nu[:, 0] = [0.0, 2.0, 1.0, 0.0, 0.0, 0.0]
    log.nu[:, 2] = [0.0, 0.0, -0.5, 0.0, 0.0, 0.0]
    log.applied[:] = log.tau
    log.held[3, 1] = 1.0
    calm = Weather(*(np.zeros((N, 3)) for _ in range(4)))
    times = 1e-6 * np.array([1.0, 9, 3, 9, 5, 9])
    voyage = Voyage(H * np.arange(N), log, PLANAR, calm, step_times=times)
    diagnostics = (
        Diagnostic("spectral_radius", "all", 1.01),
        Diagnostic("model_order", "all", 6.0),
    )
    design = ControlDesign(
        PLANAR, needed=np.array([50.0, 500.0, 1.0]), limits=(100.0, 400.0, 8.0), every=2,
        diagnostics=diagnostics,
    )  # fmt: skip
    return SimulatedMission(voyage, H, design, failures=4)


def values() -> dict[tuple[str, str], tuple[float, str]]:
    one = sailed()
    found = [
        *deployment_metrics.mission_metrics(one, "nominal"),
        *deployment_metrics.of_design(one.design, "nominal").metrics,
    ]  # fmt: skip
    assert {(metric.stage, metric.model) for metric in found} == {("deployment", "nominal")}
    return {(m.name, m.dof): (float(m.value or 0.0), m.unit) for m in found}


def test_a_metric_is_what_it_is_said_to_be() -> None:
    found = values()
    for name, dof, value, unit in (
        ("error_mae", "surge", 5.0 / 6.0, "m"),
        ("error_mse", "surge", 9.0 / 6.0, "m^2"),
        ("error_mae", "yaw", 10.0 / 6.0, "deg"),
        ("iae", "surge", 5.0 * H, "m s"),
        ("itae", "surge", (2.0 * 1.0 + 1.0 * 1.0) * H**2, "m s^2"),  # of the last set-point
        ("tau_rms", "surge", np.sqrt(22500.0 / 6.0), "N"),
        ("tau_max_abs", "surge", 100.0, "N"),
        ("tau_tv", "surge", 100.0 + 200.0 + 150.0 + 50.0, "N"),
        ("tau_tv", "yaw", 16.0, "Nm"),
        ("limit_hits", "surge", 2.0, ""),
        ("limit_hits", "yaw", 1.0, ""),
        ("infeasible_limits", "surge", 0.0, ""),
        ("infeasible_limits", "sway", 1.0, ""),
        ("energy", "position", (200.0 + 100.0) * H, "J"),
        ("energy", "heading", 4.0 * H, "J"),
        ("iaew", "position", (5.0 * H) * (300.0 * H), "m J s"),
        ("failures", "all", 4.0, ""),
        ("held_commands", "all", 1.0, ""),
        ("step_time_median", "all", 3.0, "us"),  # every second instant commands: 1, 3, 5
        ("step_time_p99", "all", 4.96, "us"),
        ("spectral_radius", "all", 1.01, ""),
    ):
        assert found[name, dof] == (pytest.approx(value), unit), (name, dof)


def test_a_mission_with_stands_has_the_figures_of_its_steps() -> None:
    """A step of 10 m at 90 s, of which a tenth is made in the 10 s before, and 4 % too far."""
    n = 360
    log = Log(*(np.zeros((n, 3)) for _ in Log._fields))
    log.setpoint[180:, 0] = 10.0
    log.eta[175:, 0], log.eta[190:, 0], log.eta[200:, 0] = 1.0, 10.4, 10.1
    calm = Weather(*(np.zeros((n, 3)) for _ in range(4)))
    voyage = Voyage(H * np.arange(n), log, PLANAR, calm)
    found = deployment_metrics.mission_metrics(
        SimulatedMission(voyage, H, ControlDesign(PLANAR, np.zeros(3))), "identified"
    )
    surge = {m.name: (m.value, m.unit) for m in found if m.dof == "surge"}
    assert surge["early_share"] == (pytest.approx(10.0), "%")
    assert surge["overshoot"] == (pytest.approx(4.0), "%")
    assert surge["rise_time"] == (pytest.approx(10 * H), "s")
    assert surge["settling_time"] == (pytest.approx(10 * H), "s")  # within 5 % from 10.4 m on
    assert surge["steady_state_error"] == (pytest.approx(0.1), "m")
