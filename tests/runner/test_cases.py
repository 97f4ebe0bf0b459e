"""Disturbance cases that are put together on the command line."""

from seatrial.runner.configuration.config import build_trial
from tests.trials import asked_for, ordered


def test_cases_add_up() -> None:
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
