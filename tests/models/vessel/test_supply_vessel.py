"""The supply vessel against the printed equations."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from seatrial.models.errors import ConfigurationError
from tests.trials import composed

motions = arrays(np.float64, (4, 3), elements=st.floats(-3.0, 3.0))
SETS = {"as_printed": (5e-5, 22e-5, 12e11, 225e-15), "physical": (5e4, 22e4, 1.2e10, 6.6e5)}


def vessel(parameters: str) -> Any:
    return composed("vessel=supply_vessel", f"vessel.parameters={parameters}").vessel


@pytest.mark.parametrize("parameters", SETS)
def test_the_table_is_the_printed_model(parameters: str) -> None:
    d1, d2, d3, d4 = SETS[parameters]
    table = vessel(parameters).nominal()

    @given(motions, motions)
    def equal(nu: np.ndarray, tau: np.ndarray) -> None:
        """Bargouth (2022), (2.24)-(2.26), with no current, no wind and no noise."""
        u, v, r = nu.T
        force = 1e6 * tau
        printed = np.column_stack(
            [
                -d1 / 2.4e7 * abs(u) * u + force[:, 0] / 2.4e7,
                -d2 / 4e7 * abs(v) * v + force[:, 1] / 4e7,
                -d3 / 4.5e10 * abs(r) * r - d4 / 4.5e10 * abs(v) * v + force[:, 2] / 4.5e10,
            ]
        )
        np.testing.assert_allclose(table.forward(force, nu), printed, rtol=1e-12, atol=1e-15)

    equal()


def test_an_unknown_set_of_parameters_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="expected one of as_printed, physical"):
        vessel("guessed")
    with pytest.raises(ConfigurationError, match="parameters: got physical, expected one of null"):
        composed("+vessel.parameters=physical")
