"""The report on an excitation: what data can and cannot tell apart."""

import numpy as np
import pytest

from seatrial.models.excitation.persistence import persistence, spectral_lines
from seatrial.models.notation import PLANAR
from seatrial.models.recording.recording import Recording, attitude_of
from seatrial.models.vessel import basis
from seatrial.models.vessel.derivatives import from_derivatives
from seatrial.models.vessel.table import Vessel

DOFS = ("surge",)


def recording(
    nu: np.ndarray, dofs: tuple[str, ...] = DOFS, tau: np.ndarray | None = None
) -> Recording:
    t = 0.1 * np.arange(len(nu))
    nu_dot = np.gradient(nu, 0.1, axis=0)
    eta = np.cumsum(nu, axis=0) * 0.1
    force = nu if tau is None else tau
    return Recording(dofs, t, eta, nu, nu_dot, force, attitude_of(dofs, eta))


def surge() -> Vessel:
    return from_derivatives("s", DOFS, np.array([[60.0]]), {"X_u": -20.0, "X_|u|u": -2.0})


def test_a_varied_motion_tells_all_terms_apart() -> None:
    t = 0.1 * np.arange(2000)
    nu = (np.sin(0.1 * t) + 0.5 * np.sin(0.73 * t))[:, None]
    (found,) = persistence(recording(nu), surge())
    assert found.persistent
    assert found.warning() is None
    assert (found.rank, found.unknowns) == (3, 3)
    phi = basis.evaluate(surge().terms, recording(nu).variables())
    scaled = phi / np.linalg.norm(phi, axis=0)
    assert found.condition == pytest.approx(np.linalg.cond(scaled))


def test_a_steady_motion_cannot_tell_damping_terms_apart() -> None:
    nu = 0.5 + 0.001 * np.sin(0.1 * np.arange(1000))[:, None]
    (found,) = persistence(recording(nu), surge())
    assert not found.persistent
    assert ("u", "|u|u") in found.inseparable or ("|u|u", "u") in found.inseparable
    assert "not told apart" in (found.warning() or "")
    assert found.rank == 2


def test_what_does_not_move_is_not_excited() -> None:
    t = 0.1 * np.arange(1000)
    nu = np.column_stack([np.sin(0.3 * t), np.zeros(1000), np.zeros(1000)])
    vessel = from_derivatives(
        "v", PLANAR, np.diag([1.0, 2.0, 3.0]), {"X_u": -1.0, "Y_v": -1.0, "N_r": -1.0}
    )
    reports = persistence(recording(nu, PLANAR), vessel)
    assert reports[0].unexcited == ("vr",)
    assert reports[1].unexcited == ("v_dot", "ur", "v")
    assert reports[1].rank == 0
    said = "yaw: 0 of 3 terms told apart, 0 spectral lines: r_dot, uv, r not excited"
    assert reports[2].warning() == said


def test_spectral_lines_are_counted() -> None:
    t = 0.1 * np.arange(4000)
    lines = [np.sin(2 * np.pi * k * t / 400.0) for k in (5, 12, 40)]
    assert spectral_lines(lines[0]) == 1
    assert spectral_lines(3.0 + sum(lines)) == 3
    assert spectral_lines(np.full(100, 7.0)) == 0
    assert spectral_lines(np.zeros(100)) == 0
    burst = np.concatenate([np.zeros(3000), 3.0 + sum(lines), np.zeros(5000)])
    assert spectral_lines(burst) == 3  # rest before and after it adds none


def test_lines_are_those_of_the_whole_experiment() -> None:
    """23 lines on every third multiple of 1 / 720 s, which half of it does not resolve."""
    t = 0.1 * np.arange(7200)
    force = sum(np.sin(2 * np.pi * (4 + 3 * k) * t / 720.0 + k * k) for k in range(23))[:, None]
    nu = (np.sin(0.1 * t) + 0.5 * np.sin(0.73 * t))[:, None]
    whole = recording(nu, tau=force)
    half = whole.part(t < 360.0)
    (found,) = persistence(half, surge(), whole)
    assert found.lines == 23
    assert persistence(half, surge())[0].lines < 23
