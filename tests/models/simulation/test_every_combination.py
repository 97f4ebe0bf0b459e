"""Vessels sail with the disturbances and the excitations that suit them, two seconds each.

What does not suit is refused by name before any work.
"""

from functools import cache
from itertools import product
from typing import Any

import numpy as np
import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import PLANAR, ROLLING
from seatrial.models.simulation.loop import sail
from seatrial.models.simulation.voyage import recording_of
from seatrial.runner.configuration.config import build_as
from seatrial.runner.configuration.vessel_options import filled
from tests.trials import CONF, FORCED, options

PERIOD_S, ROWS = 0.1, 20
FEW = ("milliampere", "surge_linear")  # `make nightly` sails all vessels
OF_INPUTS = ("kvlcc2", "mariner", "container")  # stand for all; test_matrix.py has the others
WAVES = ("waves", "rough")
FLOATING = ("wind", "wind_current", "wind_current_process", *WAVES)  # of what floats
PLANE = ("waypoints", "prbs_waypoints", "four_corner", "optimal_design")  # excitations in the plane
TURNING = ("turning_circle", "zigzag")  # of what surges and yaws
HELM = (  # by inputs, beside rudder_*
    *("spiral", "reverse_spiral", "williamson", "crash_stop"),
    *("heading_changes", "path_following", "input_prbs", "helm_sequence"),
)


@cache
def objects(vessel: str, group: str, name: str) -> Any:
    """An option of a group, composed for a vessel."""
    with initialize_config_dir(str(CONF), version_base="1.3"):
        chosen = [f"vessel={vessel}", f"{group}={name}"]
        config = OmegaConf.create(OmegaConf.to_container(compose("trial", chosen)))
        nodes: Any = {
            key: OmegaConf.to_container(config[key], resolve=True) for key in ("vessel", group)
        }
        nodes["sample_time_s"] = config.sample_time_s
        return build_as(object, filled(nodes)[group], group)


def of_inputs(excitation: str) -> bool:
    return excitation.startswith("rudder") or excitation in HELM


def suits(vessel: str, group: str, name: str) -> bool:
    dofs = objects(vessel, "vessel", vessel).dofs
    if group == "excitation" and of_inputs(name) != (vessel in OF_INPUTS):
        return False
    if group == "excitation" and name == "crash_stop":  # none has data astern
        return False
    if group == "disturbance":
        rolling = dofs == ROLLING and name not in WAVES
        return dofs == PLANAR or rolling or name not in FLOATING
    return not (name in PLANE and dofs != PLANAR) and not (name in TURNING and "yaw" not in dofs)


def test_what_does_not_suit_is_refused_by_name() -> None:
    """By the degrees of freedom alone: what is refused on one axis, in all six and in the plane."""
    for vessel, group in product(("surge_linear", "beluga_full"), ("disturbance", "excitation")):
        dofs = objects(vessel, "vessel", vessel).dofs
        for name in options(group):
            if name == "recording" or suits(vessel, group, name) or of_inputs(name):
                continue
            part = objects("surge_linear", group, name)
            with pytest.raises(ConfigurationError, match=r"needs a vessel in|windage: got null"):
                part.check(dofs)


@pytest.mark.parametrize(
    ("vessel", "whole"),
    [
        *(pytest.param(name, False, marks=pytest.mark.slow) for name in FEW),
        *(pytest.param(name, True, marks=pytest.mark.nightly) for name in (*FORCED, *OF_INPUTS)),
    ],
)
def test_every_vessel_sails_with_what_suits_it(vessel: str, whole: bool) -> None:
    """Every excitation with the disturbances in turn, or, nightly, with all of them."""
    parameters = objects(vessel, "vessel", vessel)
    dofs, table = parameters.dofs, parameters.nominal()
    name = "autopilot" if vessel in OF_INPUTS else "pid_ff"
    controller = objects(vessel, "controller", name).build(table, PERIOD_S)
    start = np.zeros(len(dofs))
    excitations, disturbances = (
        [one for one in options(group) if one != "recording" and suits(vessel, group, one)]
        for group in ("excitation", "disturbance")
    )
    assert len(excitations) >= len(disturbances)
    for number, excitation in enumerate(excitations):
        mission = objects(vessel, "excitation", excitation)
        mission.check(dofs)
        mission.check_limits(parameters.limits_by_dof, PERIOD_S)
        t = PERIOD_S * np.arange(round(mission.duration_s / PERIOD_S), dtype=np.float64)
        split = mission.split(t)
        assert 0.05 < np.mean(split.train) < 0.95
        assert not np.any(split.train & split.test)
        force = mission.force(t, dofs, np.random.default_rng(0))
        turn = number % len(disturbances)
        for disturbance in disturbances if whole else disturbances[turn : turn + 1]:
            case = objects(vessel, "disturbance", disturbance)
            case.check(dofs)
            rngs = np.random.default_rng(1), np.random.default_rng(2)
            weather = case.realise(ROWS, dofs, *rngs, PERIOD_S)
            voyage = sail(
                parameters.plant(parameters.plant_scale * table + case.aerodynamics(dofs)),
                weather, mission.guidance(t, start), mission.reference_filter.table(PERIOD_S),
                mission.steering(dofs, PERIOD_S) or controller, start, PERIOD_S,
                0.05, mission.start_velocity(dofs), added=None if force is None else force[:ROWS],
            )  # fmt: skip
            what = f"{vessel} {disturbance} {excitation}"
            assert np.all(np.isfinite(voyage.log.nu_dot)), what
            assert len(recording_of(voyage, weather)) == ROWS
            if mission.open_loop and vessel not in OF_INPUTS:
                np.testing.assert_array_equal(voyage.log.tau_fb, 0.0)
