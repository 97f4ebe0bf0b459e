"""Subspace identification of the SLICOT and DaISy records, against SLICOT's printed results.

SLICOT's routines are MOESP and N4SID, not DSR: they agree in what does not depend on the choice
of states. The variances accounted for are those of a free run over the whole record, with B, D
and the first state fitted to it, as SLICOT's toolbox reports them; 0.5 points are allowed.
"""

import csv
from pathlib import Path

import numpy as np
import pytest

from seatrial.models.identification.subspace import (
    NAMES,
    Realisation,
    identify_innovations,
    select_variant,
)
from tests.data import DATA

COLUMNS = ("name", "inputs", "outputs", "order", "L", "J")
RECORDS = [
    ("cstr", slice(1, 2), slice(2, 4), 5, 10, 10),
    ("CD_player_arm", slice(0, 2), slice(2, 4), 8, 6, 20),
    ("robot_arm", slice(0, 1), slice(1, 2), 4, 10, 20),
]


def printed(dataset: str, quantity: str) -> np.ndarray:
    with (Path(__file__).parent / "slicot.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["dataset"] == dataset]
    return np.array([float(row["value"]) for row in rows if row["quantity"] == quantity])


def example() -> tuple[np.ndarray, np.ndarray]:
    """y and u of SLICOT's example program: 1000 inputs, then 1000 outputs."""
    text = (DATA / "slicot" / "IB01AD.dat").read_text().splitlines()[2:]
    values = np.array([float(word) for line in text for word in line.split()])
    return values[1000:, None], values[:1000, None]


def daisy(name: str, inputs: slice, outputs: slice) -> tuple[np.ndarray, np.ndarray]:
    """y and u of a DaISy record, their means taken off."""
    from scipy.io import loadmat

    values = loadmat(DATA / "slicot" / f"{name}_dat.mat")[f"{name}_dat"]
    values = values - values.mean(axis=0)
    return values[:, outputs], values[:, inputs]


def variance_accounted_for(y: np.ndarray, predicted: np.ndarray) -> np.ndarray:
    """100 (1 - var(y - y_hat) / var(y)) [%] per column, the measure of the SLICOT collection."""
    return np.asarray(100.0 * (1.0 - np.var(y - predicted, axis=0) / np.var(y, axis=0)))


def free_run_vaf(found: Realisation, y: np.ndarray, u: np.ndarray) -> np.ndarray:
    start = found.model.initial_state(y, u, free_run=True)
    return variance_accounted_for(y, found.model.simulate(u, start))


@pytest.mark.data
def test_ib01ad_order_singular_values_and_eigenvalues() -> None:
    y, u = example()
    found = identify_innovations(y, u, 15, 15, None, "open", feedthrough=True)
    assert found.model.order == printed("IB01AD", "order")[0]
    expected = printed("IB01AD", "singular_value")
    values = np.std(y) * found.singular_values[: len(expected)]
    np.testing.assert_allclose(values, expected, rtol=0.02)
    real, imaginary = (printed("IB01AD", f"eigenvalue_{part}") for part in ("real", "imaginary"))
    eigenvalues = found.model.eigenvalues
    np.testing.assert_allclose(eigenvalues[:3].real, real, atol=0.02)
    np.testing.assert_allclose(eigenvalues[2:].imag, [imaginary[0], -imaginary[0]], atol=0.02)
    assert np.all(free_run_vaf(found, y, u) >= printed("IB01AD", "variance_accounted_for"))


@pytest.mark.data
@pytest.mark.parametrize("variant", ["open", "closed"])
def test_ib01ad_is_explained_by_either_variant(variant: str) -> None:
    y, u = example()
    found = identify_innovations(y, u, 15, 15, 4, variant)  # type: ignore[arg-type]
    assert np.all(free_run_vaf(found, y, u) >= printed("IB01AD", "variance_accounted_for") - 0.5)


@pytest.mark.data
@pytest.mark.parametrize(COLUMNS, RECORDS)
def test_daisy_records_are_explained_and_the_variant_that_they_choose_loses_no_point(
    name: str, inputs: slice, outputs: slice, order: int, L: int, J: int
) -> None:
    y, u = daisy(name, inputs, outputs)
    found = identify_innovations(y, u, L, J, order, "open", feedthrough=True)
    vaf = free_run_vaf(found, y, u)
    assert np.all(vaf >= printed(name, "variance_accounted_for") - 0.5), vaf
    assert found.model.predictor_radius < 1.0
    one_step = variance_accounted_for(y, found.model.predict(y, u))
    assert np.all(one_step >= vaf)  # past outputs help the predictor
    others = {
        (variant, direct): free_run_vaf(
            identify_innovations(y, u, L, J, order, variant, feedthrough=direct), y, u
        )
        for variant, direct in NAMES
    }
    chosen = others[select_variant(y, u, L, J, order).alternative]
    assert np.all(chosen >= np.max(list(others.values()), axis=0) - 1.0), others
