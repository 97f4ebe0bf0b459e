"""Every file under conf/ can be composed, and what it describes built; disturbances add up."""

from collections.abc import Iterator
from dataclasses import fields, is_dataclass, replace
from itertools import zip_longest
from pathlib import Path
from typing import Any

import pytest
from annotated_types import Le

from seatrial.models.errors import ConfigurationError
from seatrial.models.ranges import _bounds as declared
from seatrial.runner.configuration.config import build_trial
from seatrial.runner.configuration.hydra_errors import CONF
from seatrial.runner.record.vocabulary import GROUPS
from tests.trials import asked_for, composed, ordered

# An option that only works beside others, and those.
STEERED = ["vessel=kvlcc2", "controller=none", "evaluation=none"]
HEADING = ["vessel=kvlcc2", "excitation=rudder_turn", "evaluation=none"]
OF_HELM = (
    *("turn", "pull_out", "zigzag", "modified_zigzag", "prbs"),
    *("spiral", "reverse_spiral", "williamson", "crash_stop"),
)
BY_HELM = ("heading_changes", "path_following")  # by a controller
NEEDS = {
    "excitation/recording": ["vessel=surge_linear", "excitation.path=surge.csv"],
    **{f"excitation/{prefix}{name}": STEERED for name in OF_HELM for prefix in ("", "rudder_")},
    "excitation/helm_sequence": STEERED,
    "excitation/input_prbs": ["vessel=otter", *STEERED[1:]],
    **{f"excitation/{name}": ["vessel=kvlcc2", "controller=autopilot"] for name in BY_HELM},
    **{f"evaluation/{name}": [*HEADING[:2], "controller=autopilot"] for name in BY_HELM},
    **{f"controller/{name}": HEADING for name in ("autopilot", "mpc_heading")},
}
OPTIONS = {
    group: sorted(path.stem for path in (CONF / group).glob("*.yaml"))
    for group in GROUPS
    if group != "vessel"
}


@pytest.fixture(autouse=True)
def _environment(monkeypatch: pytest.MonkeyPatch, own_folder: Path) -> None:
    monkeypatch.setenv("SEATRIAL_DATA", "/data")  # composed, not read
    monkeypatch.setenv("SEATRIAL_DATABASE", "postgresql://sailor@localhost/seatrial")


@pytest.mark.slow
def test_every_option_builds() -> None:
    """An option of each group at once; one that needs others, by itself.

    Vessels are composed by test_suited_parts.py.
    """
    for names in zip_longest(*OPTIONS.values()):
        together = []
        for group, name in zip(OPTIONS, names, strict=True):
            if needed := NEEDS.get(f"{group}/{name}"):
                check_built(*needed, f"{group}={name}", group=group)
            elif name:
                together.append(f"{group}={name}")
        check_built(*together)


def check_built(*options: str, group: str = "") -> None:
    """Options are built as they are named."""
    trial = composed(*options)
    for name in [group] if group else [option.partition("=")[0] for option in options]:
        built = getattr(trial, name)
        assert f"{name}={trial.names[name]}" in options
        assert (built is None) == (trial.config[name] == {})
        check_ranges(built)


def check_ranges(built: Any) -> None:
    """Every number of an object that has a range is refused far outside it, by its name."""
    for part in parts(built):
        for field, bound, _ in declared(type(part)):
            wrong, value = 1e18 if isinstance(bound, Le) else -1e9, getattr(part, field)
            if value is not None:
                with pytest.raises(ConfigurationError, match=field):
                    replace(part, **{field: (wrong,) if isinstance(value, tuple) else wrong})


def parts(value: Any) -> Iterator[Any]:
    """The objects that an option is built of, itself among them."""
    if is_dataclass(value):
        yield value
        value = [getattr(value, field.name) for field in fields(value)]
    for each in value.values() if isinstance(value, dict) else value or ():
        if is_dataclass(each) or isinstance(each, list | tuple | dict):
            yield from parts(each)


def test_a_database_composes() -> None:
    assert composed("database=sqlite").database_url == "sqlite:///results/results.db"
    assert composed("database=postgresql").database_url == "SEATRIAL_DATABASE"


def test_the_groups_are_those_that_are_named() -> None:
    assert {*OPTIONS, "vessel"} == set(GROUPS)
    folders = {path.name for path in CONF.iterdir() if path.is_dir()}
    assert folders <= {*GROUPS, "benchmark", "database", "experiment", "hydra"}


def test_cases_of_disturbances_add_up() -> None:
    cases: list[tuple[str, str, set[str]]] = [
        ("calm", "calm", set()),
        ("[wind,noise]", "wind+noise", {"wind", "noise"}),
        ("[current, noise, process]", "current+noise+process", {"current", "noise", "process"}),
        ("rough", "rough", {"noise", "wind", "current", "waves"}),
        ("[rough,constant]", "rough+constant", {"noise", "wind", "current", "waves", "force"}),
    ]
    for choice, name, parts in cases:
        order = ordered(f"disturbance={choice}")
        assert order.names["disturbance"] == name
        made = build_trial(order.config, order.names).disturbance
        assert {part for part in vars(made) if getattr(made, part) is not None} == parts


def test_a_part_of_a_case_has_its_options() -> None:
    options = ("disturbance=[wind,noise]", "disturbance.wind.beaufort=6", "seed=3")
    assert asked_for(*options).disturbance.wind.mean_speed == 12.6
