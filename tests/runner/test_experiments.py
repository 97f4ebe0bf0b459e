"""Experiments: one file each, with the sweep in it; grids, variants and what replaces them."""

from pathlib import Path
from typing import Any

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser

from seatrial.runner.configuration.config import Limits
from seatrial.runner.configuration.hydra_errors import CONF
from seatrial.runner.sweeps.sweep import jobs_of
from tests.runner.command import Command
from tests.runner.programs import rows

PUBLISHED = CONF.parent / "docs" / "published"  # experiments with identifiers of their own
EXPERIMENTS = sorted(
    path for folder in (CONF, PUBLISHED) for path in (folder / "experiment").glob("*.yaml")
)
FEW = ("bargouth_section_4_5", "jervan_table_4_10")  # the others are checked at night


def marked(experiment: Path) -> Any:
    """A parameter of a test that checks the experiment; `data` where it reads outside data."""
    reads_data = "SEATRIAL_DATA" in experiment.read_text()
    marks = [pytest.mark.data] if reads_data else []
    return pytest.param(
        experiment, marks=marks if experiment.stem in FEW else [*marks, pytest.mark.nightly]
    )


@pytest.fixture
def parser() -> OverridesParser:
    return OverridesParser.create()


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


def test_an_experiment_with_a_sweep_needs_no_flag(seatrial: Command) -> None:
    fake = seatrial.pretend()
    seatrial.succeeds("experiment=jervan_table_4_10")
    assert fake.ran == [0, 0, 0]
    query = "SELECT name, identifier FROM sweep JOIN run ON sweep.id = sweep_id ORDER BY 2"
    identifiers = ("ls", "ls", "surface_plsr")
    assert rows(seatrial.folder, query) == [("jervan_table_4_10", name) for name in identifiers]


@pytest.mark.slow
@pytest.mark.parametrize(
    "experiment", [marked(path) for path in EXPERIMENTS], ids=lambda path: path.stem
)
def test_every_trial_of_every_experiment_passes_its_checks(
    seatrial: Command, experiment: Path
) -> None:
    folder = experiment.parents[1]
    more = [] if folder == CONF else [f"--config-dir={folder}"]
    answer = seatrial.succeeds(*more, f"experiment={experiment.stem}", "seed=0", "dry_run=true")
    states = {line.split()[0] for line in answer.out.splitlines()[:-1]}
    assert states <= {"new"}, answer.out


def test_an_experiment_names_one_option_of_each_group() -> None:
    """Hydra does not tell which options a list took, so the logbook could not name them."""
    lines = [line for path in EXPERIMENTS for line in path.read_text().splitlines()]
    assert not [line for line in lines if "override /" in line and "[" in line]
