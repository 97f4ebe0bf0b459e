"""Ljungberg (slides): which estimators err less with more samples."""

from collections.abc import Callable

import numpy as np
import pytest

from seatrial.runner.record.rows import Results

LEAST_SQUARES = "identifier.instruments=none"
INSTRUMENTS = "identifier.instruments=simulated"


@pytest.mark.nightly
@pytest.mark.parametrize(("wind", "measured"), [(0.2, "false"), (2.0, "true")])
def test_instruments_forget_their_error_and_least_squares_does_not(
    run: Callable[..., Results], metric: Callable[..., dict[str, float]], wind: float, measured: str
) -> None:
    """IV2 in low wind and IV3 in high wind, against LS with the same predictor."""

    def error(instruments: str, length_s: int) -> float:
        options = (
            "experiment=ljungberg_estimators",
            f"disturbance.wind.speed_m_s={wind}",
            f"excitation.length_s={length_s}",
            instruments,
            "identifier.orientation_terms=true",
            f"identifier.wind_measurement={measured}",
        )
        seeds = [run(*options, f"seed={seed}") for seed in range(8)]
        return float(np.median([metric(one, "coefficient_error_median")["all"] for one in seeds]))

    short, long = (error(INSTRUMENTS, length) for length in (1000, 8000))
    assert long < 0.5 * short
    short, long = (error(LEAST_SQUARES, length) for length in (1000, 8000))
    assert long == pytest.approx(short, rel=0.2)
    assert error(INSTRUMENTS, 8000) < 0.25 * long
