"""Experiments: one file each, with the sweep in it; grids, variants and what replaces them."""

from typing import Any

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser

from seatrial.runner.config import Limits
from seatrial.runner.database import Logbook
from seatrial.runner.hydra_errors import CONF
from seatrial.runner.sweep import jobs_of
from tests.runner.command import Command

EXPERIMENTS = sorted(path.stem for path in (CONF / "experiment").glob("*.yaml"))


def marked(experiment: str) -> Any:
    """A parameter of a test that runs the experiment, marked `data` where it reads outside data."""
    text = (CONF / "experiment" / f"{experiment}.yaml").read_text()
    return pytest.param(experiment, marks=[pytest.mark.data] if "SEATRIAL_DATA" in text else [])


@pytest.fixture
def parser() -> OverridesParser:
    return OverridesParser.create()


def test_variants_each_have_the_whole_grid(parser: OverridesParser) -> None:
    variants = [{"identifier": "ls"}, {"identifier": "plsr", "identifier.joint": False}]
    assert jobs_of(parser, {"seed": "range(0,2)"}, variants, [], Limits()) == [
        ["seed=0", "identifier=ls"],
        ["seed=1", "identifier=ls"],
        ["seed=0", "identifier=plsr", "identifier.joint=False"],
        ["seed=1", "identifier=plsr", "identifier.joint=False"],
    ]


def test_a_variant_replaces_params_and_the_command_line_both(parser: OverridesParser) -> None:
    params, variants = {"seed": "0,1", "plant.scale": 0.5}, [{"plant.scale": 0.25}, {}]
    assert jobs_of(parser, params, variants, ["seed=7"], Limits()) == [
        ["plant.scale=0.25", "seed=7"],
        ["plant.scale=0.5", "seed=7"],
    ]


def test_values_of_yaml_are_written_as_on_the_command_line(parser: OverridesParser) -> None:
    variant = {"update": None, "identifier.basis": ["u_dot", "u"], "plant.change": {"at_s": 3.0}}
    (job,) = jobs_of(parser, {}, [variant], [], Limits())
    assert job == ["update=null", "identifier.basis=[u_dot,u]", "plant.change={at_s:3.0}"]


def test_without_either_the_command_line_is_the_grid(parser: OverridesParser) -> None:
    assert jobs_of(parser, {}, [], ["seed=1,2"], Limits()) == [["seed=1"], ["seed=2"]]


def test_an_experiment_with_a_sweep_needs_no_flag(seatrial: Command) -> None:
    fake = seatrial.pretend()
    answer = seatrial("experiment=jervan_table_4_10")
    assert answer.code == 0
    assert fake.ran == [0, 0, 0]
    with Logbook.read("sqlite:///results/results.db") as logbook:
        (sweep,) = logbook.sweeps()
        runs = logbook.runs()
    assert sweep.name == "jervan_table_4_10"
    assert sorted(run.identifier for run in runs) == ["ls", "ls", "surface_plsr"]


@pytest.mark.parametrize("experiment", [marked(name) for name in EXPERIMENTS])
def test_every_trial_of_every_experiment_passes_its_checks(
    seatrial: Command, experiment: str
) -> None:
    answer = seatrial(f"experiment={experiment}", "seed=0", "dry_run=true")
    assert answer.code == 0, answer.err
    states = {line.split()[0] for line in answer.out.splitlines()[:-1]}
    assert states <= {"new"}, answer.out


@pytest.mark.parametrize("experiment", EXPERIMENTS)
def test_an_experiment_names_one_option_of_each_group(experiment: str) -> None:
    """Hydra does not tell which options a list took, so the logbook could not name them."""
    text = (CONF / "experiment" / f"{experiment}.yaml").read_text()
    assert not [line for line in text.splitlines() if "override /" in line and "[" in line]
