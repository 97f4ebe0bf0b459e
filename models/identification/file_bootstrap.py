"""Bootstrap of an output-error fit over the files that it was trained on.

A replicate draws as many files as there are, with repetition, and takes one Gauss-Newton step from
the fit:

    p = p_hat + (sum_f c_f J_f'J_f + P)^-1 (sum_f c_f J_f'e_f - P (p_hat - p_0))

with c_f the times that file f was drawn, and the precision P of the prior about p_0. The files,
not the samples, are the independent units: Efron and Tibshirani (1993), An Introduction to the
Bootstrap, chapter 8.
"""

import numpy as np
from numpy.typing import NDArray

from seatrial.models.errors import IdentificationError
from seatrial.models.identification.free_parameters import FreeParameters
from seatrial.models.identification.prediction_fit import Fit
from seatrial.models.vessel.basis import Array

FEWEST = 3  # files


def file_bootstrap(
    fit: Fit, believed: Array, box: tuple[Array, Array], file: NDArray[np.int64] | None,
    count: int, rng: np.random.Generator,
) -> Array:  # fmt: skip
    """Design points (count, m) of the replicates.

    Args:
        fit: the fit, whose Jacobian and residuals are in units of their deviations.
        believed: the parameters that the prior is about, shape (m,).
        box: lower and upper bounds of the parameters, shape (m,) each.
        file: number of the file of each sample, shape (N,).
        count: replicates.
        rng: draws the files.

    Returns:
        The parameters of the replicates, shape (count, m).

    Raises:
        IdentificationError: there are fewer than three files.
    """
    numbers = np.zeros(0) if file is None else np.unique(file)
    if len(numbers) < FEWEST:
        raise IdentificationError(
            f"identifier.resample=files: got {max(len(numbers), 1)} files to train on, expected at "
            f"least {FEWEST}"
        )
    outputs, m = fit.rest.shape[1], len(fit.point)
    jacobian = fit.jacobian.reshape(-1, outputs, m)
    parts = [(jacobian[file == f].reshape(-1, m), fit.rest[file == f].ravel()) for f in numbers]
    normals = np.stack([J.T @ J for J, _ in parts])
    right = np.stack([J.T @ e for J, e in parts])
    pull = fit.precision * (fit.point - believed)
    points = np.empty((count, m))
    for k in range(count):
        drawn = rng.multinomial(len(parts), np.full(len(parts), 1.0 / len(parts)))
        normal = np.tensordot(drawn, normals, axes=1) + np.diag(fit.precision)
        step = np.linalg.lstsq(normal, drawn @ right - pull, rcond=None)[0]
        points[k] = np.clip(fit.point + step, *box)
    return points


def errors_of_replicates(
    free: FreeParameters, points: Array
) -> tuple[Array, dict[str, float], Array]:
    """Standard errors of the table and of devices, and the covariance, of points (count, m)."""
    covariance = np.atleast_2d(np.cov(points.T))
    own = free.device_errors(np.sqrt(np.diag(covariance)))
    return free.std_error(covariance), own, covariance
