"""The JSON schema of all options takes every file of conf, and refuses what a trial refuses."""

import json
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator
from omegaconf import OmegaConf

from docs.schema import schema
from seatrial.runner.hydra_errors import CONF
from seatrial.runner.vocabulary import GROUPS

ROOT = Path(__file__).parents[1]
FILES = sorted(
    path.relative_to(CONF).as_posix()
    for path in CONF.rglob("*.yaml")
    if path.relative_to(CONF).parts[0] not in ("hydra", "benchmark")  # Hydra's own options, tasks
)


@cache
def validator(name: str = "") -> Draft202012Validator:
    """Of a whole configuration, or of one definition."""
    whole = schema()
    part = {"$defs": whole["$defs"], "$ref": f"#/$defs/{name}"}
    return Draft202012Validator(part if name else whole)


def complaints(node: Any, name: str = "") -> list[str]:
    return [error.message for error in validator(name).iter_errors(node)]


def test_it_is_a_schema() -> None:
    Draft202012Validator.check_schema(schema())


@pytest.mark.parametrize("file", FILES)
def test_a_file_of_the_configuration(file: str) -> None:
    node = OmegaConf.to_container(OmegaConf.load(CONF / file))
    group = file.partition("/")[0]
    assert not complaints(node, group if group in (*GROUPS, "database") else "")


@pytest.mark.parametrize(
    "changes",
    [
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
    ],
    ids=str,
)
def test_refuses(changes: dict[str, Any]) -> None:
    assert complaints(changes)


def test_defaults_and_descriptions_are_those_of_the_files() -> None:
    whole = schema()
    period = whole["properties"]["sample_time_s"]
    line = f"sample_time_s: {period['default']}  # {period['description']}"
    assert line in (CONF / "trial.yaml").read_text().splitlines()
    option = whole["$defs"]["vessel.milliampere"]
    node: Any = OmegaConf.to_container(OmegaConf.load(CONF / "vessel/milliampere.yaml"))
    assert {name: one["default"] for name, one in option["properties"].items()} == node


def test_the_command_prints_it() -> None:
    command = [sys.executable, "-m", "docs.schema"]
    printed = subprocess.run(command, cwd=ROOT, capture_output=True, check=True, text=True).stdout
    assert json.loads(printed) == schema()
