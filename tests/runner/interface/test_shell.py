"""What Python says of options is what Hydra reads."""

from pathlib import Path

import numpy as np
import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser
from hypothesis import given
from hypothesis import strategies as any_

from seatrial.models.errors import ConfigurationError
from seatrial.runner.configuration.config import build_trial
from seatrial.runner.configuration.search_path import CONF
from seatrial.runner.interface.shell import overrides_of, place_of, text_of
from seatrial.runner.record.vocabulary import GROUPS
from seatrial.runner.sweeps.composition import spread
from seatrial.runner.sweeps.in_process import composed

PARSER = OverridesParser.create()


def read(text: str) -> object:
    """The value that Hydra reads."""
    override = PARSER.parse_override(f"key={text}")
    assert not override.is_sweep_override()
    return override.value()


@given(any_.text(any_.characters(codec="utf-8", exclude_categories=["Cc"])))
def test_text_is_read_as_it_was_written(text: str) -> None:
    assert read(text_of(text, "key")) == text


@given(
    any_.recursive(
        any_.none() | any_.booleans() | any_.integers() | any_.floats(allow_nan=False),
        lambda inner: (
            any_.lists(inner, max_size=3)
            | any_.dictionaries(any_.from_regex("[a-z]+", fullmatch=True), inner, max_size=3)
        ),
    )
)
def test_values_are_read_as_they_were_written(value: object) -> None:
    if isinstance(value, dict) and {"null", "nan", "inf", "true", "false"} & set(value):
        return
    assert repr(read(text_of(value, "key"))) == repr(value)


def test_arrays_and_paths_are_values() -> None:
    assert read(text_of(np.array([1.5, 2.0]), "key")) == [1.5, 2.0]
    assert read(text_of(np.int64(3), "key")) == 3
    assert read(text_of(Path("a folder/it's.csv"), "key")) == "a folder/it's.csv"


def test_a_range_is_a_sweep() -> None:
    override = PARSER.parse_override(f"seed={text_of(range(2, 8, 3), 'key')}")
    assert [int(text) for text in override.sweep_string_iterator()] == [2, 5]


def test_names_of_nested_options() -> None:
    options = {"identifier": "ls", "identifier__basis": "physical", "seed": 1}
    assert overrides_of(options) == ["identifier=ls", "identifier.basis=physical", "seed=1"]
    assert overrides_of({"controller": {"kp": [1, 2]}}) == ["controller={kp:[1,2]}"]
    assert spread(["controller={kp:[1,2]}", "seed=1"]) == ["controller.kp=[1,2]", "seed=1"]
    assert overrides_of({"plant__change": {"at_s": 3}}) == ["plant.change={at_s:3}"]


@pytest.mark.parametrize("name", ["milliampere", "kvlcc2", "otter"])
def test_a_part_as_an_object_is_that_of_its_name(name: str) -> None:
    """Also what follows it: the excitation and the controller that a vessel chooses."""
    named = composed([f"vessel={name}"])
    trial = build_trial(named.config, named.names)
    of_objects = composed(overrides_of({"vessel": trial.vessel}))
    again = build_trial(of_objects.config, of_objects.names)
    assert of_objects.names == named.names
    parts = ("vessel", "excitation", "controller", "identifier")
    assert [getattr(again, part) for part in parts] == [getattr(trial, part) for part in parts]
    controller = "none" if trial.controller is None else trial.controller
    words = overrides_of({"controller": controller, "identifier": trial.identifier})
    given = composed([f"vessel={name}", *words])
    own = build_trial(given.config, given.names)
    assert (own.controller, own.identifier) == (trial.controller, trial.identifier)


def test_a_mapping_with_a_target_replaces_the_group() -> None:
    target = "seatrial.models.control.pid.PidFeedforward"
    order = composed(overrides_of({"controller": {"_target_": target, "kp": [1.0, 2.0, 3.0]}}))
    assert order.names["controller"] == "PidFeedforward"
    controller = build_trial(order.config, order.names).controller
    assert controller.kp == (1.0, 2.0, 3.0)  # type: ignore[union-attr]
    assert min(controller.ki) > 0.0  # type: ignore[union-attr]  # from the vessel


def test_a_group_takes_a_path() -> None:
    names = dict(zip(GROUPS, ("otter", "noise", "prbs", "ls", "lqi", "square"), strict=True))
    for group, name in names.items():
        own = composed(overrides_of({group: CONF / group / f"{name}.yaml"}))
        assert own.config == composed([f"{group}={name}"]).config


def test_what_is_no_value_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="seed: got object, expected text, numbers or"):
        overrides_of({"seed": object()})
    for group in GROUPS:
        with pytest.raises(ConfigurationError, match=f"{group}: got a name without _target_"):
            composed(overrides_of({group: {"name": "tug"}}))


def test_places(monkeypatch: pytest.MonkeyPatch) -> None:
    assert place_of(None) == []
    assert place_of("a/b.db") == ["results_dir=a", "database.url=sqlite:///a/b.db"]
    server = "postgresql://user@host/name"
    assert place_of(server) == [f"database.url='{server}'"]
    monkeypatch.setenv("SEATRIAL_DATABASE", server)
    assert place_of("SEATRIAL_DATABASE") == ["database.url=SEATRIAL_DATABASE"]
