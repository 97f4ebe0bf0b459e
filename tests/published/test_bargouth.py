"""Bargouth (2022): what the text says of the responses that its figures show."""

from collections.abc import Callable

import numpy as np
import pytest

from seatrial.runner.record.rows import Results

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


def test_with_the_printed_drag_the_linear_model_drifts_as_the_vessel_but_does_not_turn_so(
    run: Callable[..., Results],
) -> None:
    """Section 4.2: two double integrators in surge and sway; what is left goes with the step."""
    errors = {}
    for period in (1.0, 0.5):
        one = run(
            "experiment=bargouth_section_4_2", "vessel.parameters=as_printed",
            f"sample_time_s={period}", f"integration_step_s={period}",
        )  # fmt: skip
        errors[period] = diagnostic(one, "body_pose_rmse_free_run")
    for dof in ("surge", "sway"):
        assert errors[0.5][dof] == pytest.approx(0.5 * errors[1.0][dof], rel=0.05)
        assert diagnostic(one, "fit_free_run")[dof] > 99.0
    assert diagnostic(one, "fit_free_run")["yaw"] < 0.0


def diagnostic(results: Results, name: str) -> dict[str, float | None]:
    """Value by degree of freedom."""
    return {row.dof: row.value for row in results.diagnostics if row.name == name}


@pytest.mark.parametrize(
    ("options", "at_one"),
    [
        (["vessel.parameters=as_printed"], 6),
        (["vessel.parameters=physical"], 6),
        (
            ["vessel.parameters=physical", "identifier.velocity={surge:0.024,sway:0.009}",
             "identifier.operating_force=false"],
            4,
        ),
    ],
)  # fmt: skip
def test_the_linear_model_is_controllable_and_observable_but_not_stable(
    run: Callable[..., Results], options: list[str], at_one: int
) -> None:
    """Section 4.3: ranks 6 and 6; eigenvalues of 0.999 belong to a current of some cm/s."""
    one = run("experiment=bargouth_section_4_3", *options)
    assert diagnostic(one, "controllable_order") == diagnostic(one, "observable_order")
    assert diagnostic(one, "controllable_order")["all"] == 6.0
    assert diagnostic(one, "spectral_radius")["all"] == pytest.approx(1.0)
    assert diagnostic(one, "eigenvalues_at_one")["all"] == at_one
    values = [row.value for row in one.diagnostics if row.name == "eigenvalue_real"]
    assert sum(round(value or 0.0, 3) == 0.999 for value in values) == 6 - at_one
