"""Vessels excited in open loop without a controller, and those of the configuration."""

from collections.abc import Callable
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from seatrial.models.excitation.signals import many_sine, triple_ramp
from seatrial.models.identification.free_run import course_of, free_run
from seatrial.models.identification.problem import Problem
from seatrial.models.recording.recording import Recording, attitude_of
from seatrial.models.vessel.derivatives import from_derivatives
from seatrial.models.vessel.table import Vessel
from tests.models.conftest import configured

STEP_S = 0.1
SAMPLES = 1000
FAR = 1e6  # a limit of the rates that nothing reaches


def forced(tau: np.ndarray, dofs: tuple[str, ...]) -> Recording:
    """A recording of a force (N, n_dof) alone; it stands still."""
    still = np.zeros((len(tau), len(dofs)))
    t = STEP_S * np.arange(len(tau))
    return Recording(dofs, t, still, still, still, tau.reshape(still.shape), np.zeros((len(t), 3)))


def driven(
    vessel: Vessel, tau: np.ndarray, integrator: str = "euler", noise: float = 0.0, seed: int = 0
) -> Recording:
    """What a vessel does under a force, from rest, with white noise on pose and velocity."""
    empty = forced(tau, vessel.dofs)
    states = free_run(vessel, course_of(empty, None, None, None, FAR, vessel.attitude), integrator)
    states += noise * np.random.default_rng(seed).standard_normal(states.shape)
    eta, nu = np.split(states, 2, axis=1)
    return Recording(
        vessel.dofs, empty.t, eta, nu, empty.nu_dot, empty.tau, attitude_of(vessel.dofs, eta)
    )


def surge(mass: float, drag: float, term: str | None = None, more: float = 0.0) -> Vessel:
    """m u_dot + d u + d_NL term = X. Hoyer (2021), sections 2.3.4 and 2.3.5."""
    derivatives = {"X_u": -drag} | ({f"X_{term}": -more} if term else {})
    return from_derivatives("surge", ("surge",), np.array([[mass]]), derivatives)


def problem(truth: Vessel, nominal: Vessel, tau: np.ndarray, **options: Any) -> Problem:
    """To identify `truth`, driven by a force, from the nominal one of it."""
    recording = driven(truth, tau, **options)
    return Problem(recording, recording, nominal, None)


@pytest.fixture(scope="session")
def make() -> SimpleNamespace:
    return SimpleNamespace(surge=surge, driven=driven, forced=forced, problem=problem)


@pytest.fixture(scope="session")
def signal() -> Callable[[str], np.ndarray]:
    """signal(name) -> the force of 100 s [N], sampled at 0.1 s."""
    t = STEP_S * np.arange(SAMPLES)
    return {"triple_ramp": triple_ramp(t), "many_sine": many_sine(t)}.__getitem__


@pytest.fixture(scope="session")
def vessel() -> Callable[[str], Vessel]:
    """vessel(name) -> the nominal model of conf/vessel/<name>.yaml."""
    return lambda name: configured("vessel", name).nominal()


@pytest.fixture(scope="session")
def estimator(identifier: Callable[..., Any]) -> Callable[..., Any]:
    """The identifiers by themselves, without smoothing and physical constraints."""
    return partial(identifier, lowpass_hz=None, inertia_factor=None)
