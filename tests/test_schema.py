"""The JSON schema of all options takes every file of conf, and refuses what a trial refuses."""

import json
import runpy
from functools import cache
from typing import Any

import pytest
from jsonschema import Draft202012Validator
from omegaconf import OmegaConf

from docs import schema as program
from seatrial.runner.configuration.hydra_errors import CONF
from seatrial.runner.record.vocabulary import GROUPS

FILES = sorted(
    path.relative_to(CONF).as_posix()
    for path in CONF.rglob("*.yaml")
    if path.relative_to(CONF).parts[0] not in ("hydra", "benchmark")  # Hydra's own options, tasks
)


@cache
def schema() -> dict[str, Any]:
    return program.schema()


@cache
def validator(name: str = "") -> Draft202012Validator:
    """Of a whole configuration, or of one definition."""
    part = {"$defs": schema()["$defs"], "$ref": f"#/$defs/{name}"}
    return Draft202012Validator(part if name else schema())


def complaints(node: Any, name: str = "") -> list[str]:
    return [error.message for error in validator(name).iter_errors(node)]


@pytest.mark.slow
def test_it_is_a_schema_that_takes_every_file_of_the_configuration() -> None:
    Draft202012Validator.check_schema(schema())
    found = []
    for file in FILES:
        node = OmegaConf.to_container(OmegaConf.load(CONF / file))
        group = file.partition("/")[0]
        name = group if group in (*GROUPS, "database") else ""
        found += [(file, complaint) for complaint in complaints(node, name)]
    assert found == []


@pytest.mark.slow
def test_it_refuses_what_a_trial_refuses() -> None:
    changes: list[dict[str, Any]] = [
        {"seeds": 1},
        {"seed": -1},
        {"seed": 1.5},
        {"sample_time_s": 0},
        {"sample_time_s": "fast"},
        {"rerun": "yes"},
        {"plant": {"scale": 0.0}},
        {"identifier": {"lowpass": 1.0}},
        {"identifier": {"lowpass_hz": -1.0}},
        {"disturbance": {"wind": {"speed_m_s": -1.0}}},
        {"vessel": {"velocity_limits": [1.0, "x"]}},
    ]
    assert [change for change in changes if not complaints(change)] == []


def test_defaults_and_descriptions_are_those_of_the_files(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """In what the command prints."""
    runpy.run_path(program.__file__, run_name="__main__")
    schema = json.loads(capsys.readouterr().out)
    period = schema["properties"]["sample_time_s"]
    line = f"sample_time_s: {period['default']}  # {period['description']}"
    assert line in (CONF / "trial.yaml").read_text().splitlines()
    option = schema["$defs"]["vessel.milliampere"]
    node: Any = OmegaConf.to_container(OmegaConf.load(CONF / "vessel/milliampere.yaml"))
    assert {name: one["default"] for name, one in option["properties"].items()} == node
