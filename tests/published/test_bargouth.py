"""Bargouth (2022): what the text says of the responses that its figures show."""

from collections.abc import Callable

import numpy as np
import pytest

from runner.database.records import Results

Metric = Callable[..., dict[str, float]]


@pytest.mark.slow
def test_lq_without_limits_takes_the_times_and_forces_that_are_told(
    run: Callable[..., Results], metric: Metric
) -> None:
    """Section 4.6.1: 2.5 and 3 min in sway, 4.5e5 N, 6e6 Nm; other weather than the source's."""
    runs = [
        run("experiment=bargouth_section_4_6", "controller.limited=false", f"seed={seed}")
        for seed in range(10)
    ]

    def mean(name: str, dof: str) -> float:
        return float(np.mean([metric(one, name, "nominal")[dof] for one in runs]))

    assert 150.0 <= mean("settling_time", "sway") <= 180.0
    assert mean("tau_max_abs", "sway") == pytest.approx(4.5e5, rel=0.1)
    assert mean("tau_max_abs", "yaw") == pytest.approx(6e6, rel=0.2)


@pytest.mark.slow
def test_three_formulations_of_predictive_control_are_one(
    run: Callable[..., Results], metric: Metric
) -> None:
    """Section 4.5: standard, reduced and simple; a schedule cut short."""
    common = ("experiment=bargouth_section_4_5", "evaluation.duration_s=240")
    errors = [
        metric(run(*common, f"controller=mpc_{name}"), "error_mae", "nominal")
        for name in ("standard", "reduced", "condensed")
    ]
    for other in errors[1:]:
        assert other == pytest.approx(errors[0], rel=1e-5)
