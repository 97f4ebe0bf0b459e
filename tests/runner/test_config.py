"""Nodes of a configuration become checked objects; errors name the key."""

from pathlib import Path
from typing import Any

import pytest

from seatrial.models.errors import ConfigurationError
from seatrial.models.vessel.thruster import SecondOrderLag
from seatrial.runner.configuration.config import build_as, build_trial
from seatrial.runner.record.vocabulary import GROUPS

LAG = {
    "_target_": "seatrial.models.vessel.thruster.SecondOrderLag",
    "natural_frequency_rad_s": 2,
    "damping": 0.8,
}
VESSEL = {
    "_target_": "seatrial.models.vessel.parameters.VesselParameters",
    **{"name": "buoy", "dofs": ["surge"], "inertia": [[10.0]], "derivatives": {"X_u": -1.0}},
    "velocity_limits": [5.0],
}
PARTS = {
    "vessel": VESSEL,
    "disturbance": {"_target_": "seatrial.models.weather.disturbance.Disturbance"},
    "excitation": {
        "_target_": "seatrial.models.excitation.setpoints.Setpoints",
        **{"schedule": "stay", "schedules": {"stay": [[0, 0, 0]]}, "scale": 1, "duration_s": 10},
        "reference_filter": {"_target_": "seatrial.models.excitation.setpoints.Step"},
    },
    "identifier": {"_target_": "seatrial.models.identification.problem.NoIdentifier"},
}
NAMES = dict.fromkeys(GROUPS, "none")


def configuration(**changes: Any) -> dict[str, Any]:
    """A whole configuration that sails no evaluation, with changes."""
    return {
        **{group: {} for group in GROUPS}, **PARTS, "seed": 0, "sample_time_s": 0.1,
        "integration_step_s": 0.05, "plant": {"scale": 0.5}, "results_dir": "results",
        "database": {"url": "sqlite:///results/results.db"}, "rerun": False, "dry_run": False,
    } | changes  # fmt: skip


def refusal(node: Any, key: str = "thruster") -> str:
    with pytest.raises(ConfigurationError) as caught:
        build_as(object, node, key)
    return str(caught.value)


def test_builds_an_object() -> None:
    lag = build_as(object, LAG, "thruster")
    assert lag == SecondOrderLag(natural_frequency_rad_s=2.0, damping=0.8)
    vessel = build_as(object, VESSEL | {"thruster": LAG}, "vessel")
    assert vessel.thruster == lag
    assert build_as(object, {}, "controller") is None
    assert build_as(object, None, "controller") is None


def test_an_error_names_the_key_inside_a_node() -> None:
    said = refusal(VESSEL | {"thruster": LAG | {"damping": "much"}}, "vessel")
    assert said == "vessel.thruster.damping: got 'much', expected a number"
    said = refusal(VESSEL | {"thruster": VESSEL}, "vessel")
    assert said == "vessel.thruster: got VesselParameters, expected SecondOrderLag"
    said = refusal(VESSEL | {"dofs": ["surge", "surge"]}, "vessel")  # an error of the class
    assert said.startswith("vessel: ")


def test_a_target_must_be_a_dataclass_of_ours() -> None:
    ours = "seatrial.models.vessel"
    for target in (
        "os.system", "subprocess.Popen", "seatrial.modelsX.thruster.SecondOrderLag",
        "seatrial.models", f"{ours}.thruster", f"{ours}.thruster.Nothing",
        "seatrial.models.nowhere.SecondOrderLag", f"{ours}.table.np.ndarray",
        f"{ours}.parameters.field", "seatrial.models.errors.Diverged",
        "seatrial.runner.configuration.fingerprint.subprocess.Popen",
        "seatrial.runner.configuration.config.Path",
        "seatrial.runner..config.Trial", "", 3, None,
    ):  # fmt: skip
        assert refusal({"_target_": target}).startswith(f"thruster._target_: got {target!r}")


def test_a_node_needs_a_target() -> None:
    assert refusal({"damping": 1}) == "thruster._target_ is missing, expected the name of a class"
    assert refusal(3) == "thruster: got 3, expected a group of options"
    assert refusal("ls") == "thruster: got 'ls', expected a group of options"


def test_builds_a_trial() -> None:
    config = configuration(plant={"scale": 2}, seed=7)
    trial = build_trial(config, NAMES)
    assert (trial.seed, trial.plant.scale, trial.sample_time_s) == (7, 2.0, 0.1)
    assert trial.results_dir == Path("results")
    assert trial.config == config
    assert trial.controller is None


REFUSED: list[tuple[dict[str, Any], str]] = [  # kinds of values: test_options.py
    ({"integration_step_s": 0.2},
     "integration_step_s must not be above sample_time_s = 0.1, got 0.2"),
    ({"plant": {}}, "plant.scale is missing"),
    ({"plant": {"scale": 1, "mass": 2}},
     "plant.mass: unknown option, expected one of scale, change"),
    ({"seeds": 1}, "seeds: unknown option, did you mean seed or sweep?"),
    ({"vessel": "ferry"}, "vessel: got 'ferry', expected a group of options"),
]  # fmt: skip


def test_refuses_a_trial(subtests: pytest.Subtests) -> None:
    for changes, message in REFUSED:
        with subtests.test(message):
            with pytest.raises(ConfigurationError) as caught:
                build_trial(configuration(**changes), NAMES)
            assert str(caught.value) == message
