"""Subspace identification against nfoursid, at the same horizons, from the same data.

16,000 samples of a stable plant of order 6 with 3 inputs and 3 outputs, white inputs and coloured
noise, in an open loop. nfoursid decomposes a matrix with as many columns as there are samples by a
singular value decomposition with all right vectors, 2 GB of them; its second row asks NumPy for
those alone that it uses, which its users cannot do. About 4 minutes.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np
import pytest

from seatrial.models.identification.subspace import identify_innovations
from seatrial.models.simulation.statespace import StateSpace
from tests.models.identification.test_subspace import (
    by_size,
    kalman_gain,
    markov_error,
    open_loop,
    random_plant,
)

pandas = pytest.importorskip("pandas", reason="nfoursid needs pandas")
nfoursid = pytest.importorskip("nfoursid.nfoursid", reason="nfoursid: pip install '.[bench]'")

SAMPLES, ORDER, HORIZON = 16_000, 6, 10
EIGENVALUES, MARKOV, ONE_STEP = 5e-3, 2e-3, 1e-3  # agreed with the truth
OUTPUTS, INPUTS = ["y1", "y2", "y3"], ["u1", "u2", "u3"]


@cache
def data() -> tuple[np.ndarray, np.ndarray, np.ndarray, StateSpace]:
    """Outputs, inputs, innovations and the plant."""
    rng = np.random.default_rng(0)
    plant = random_plant(rng)
    truth = replace(plant, K=kalman_gain(plant, 0.1 * np.eye(ORDER), np.eye(3)))
    return *open_loop(truth, SAMPLES, 0.1, rng), truth


def ours(variant: str) -> StateSpace:
    y, u, _, _ = data()
    return identify_innovations(y, u, HORIZON, HORIZON, ORDER, variant).model  # type: ignore[arg-type]


def theirs() -> StateSpace:
    """N4SID of nfoursid, with the matrices and the covariances that it returns."""
    y, u, _, _ = data()
    frame = pandas.DataFrame(np.hstack([y, u]), columns=[*OUTPUTS, *INPUTS])
    peer = nfoursid.NFourSID(frame, OUTPUTS, INPUTS, num_block_rows=HORIZON)
    peer.subspace_identification()
    model, _ = peer.system_identification(rank=ORDER)
    return StateSpace(model.a, model.b, model.c, model.d, 1.0)


def thin() -> StateSpace:
    """The same, with the right singular vectors that it uses and no others."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(np.linalg, "svd", partial(np.linalg.svd, full_matrices=False))
        return theirs()


def is_right(model: StateSpace) -> None:
    """Eigenvalues and Markov parameters are the truth's; so is what a predictor leaves."""
    y, u, e, truth = data()
    np.testing.assert_allclose(by_size(model), by_size(truth), rtol=0.0, atol=EIGENVALUES)
    assert markov_error(model, truth) < MARKOV
    if model.K is not None:
        left = np.mean((y - model.predict(y, u)) ** 2) / np.mean(e**2)
        assert np.sqrt(left) == pytest.approx(1.0, abs=ONE_STEP)


ROWS = [
    ("closed", theirs, "nfoursid, N4SID", 15.0, 2),
    ("closed", thin, "nfoursid with a thin SVD", None, 7),
    ("open", thin, "nfoursid with a thin SVD", None, 7),
]


@pytest.mark.parametrize(("variant", "peer", "name", "wanted", "rounds"), ROWS)
def test_dsr(
    in_turn: Any, variant: str, peer: Callable[[], StateSpace], name: str, wanted: Any, rounds: int
) -> None:
    is_right(ours(variant))
    is_right(peer())
    in_turn(
        partial(ours, variant), peer, item="5",
        what="subspace identification, 16,000 samples, 3 x 3, order 6, horizons 10 and 10",
        name=f"DSR, {variant} variant", peer_name=name, wanted=wanted, rounds=rounds,
        note=f"both agree with the truth: eigenvalues to {EIGENVALUES:.0e}, Markov parameters to "
        f"{MARKOV:.0e}",
    )  # fmt: skip
