"""A controller in Python commands what the compiled one does, in the same loop."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from seatrial.models.control.controller import PythonController, Signals
from seatrial.models.control.pid import body_error_kernel
from seatrial.models.errors import PartError
from seatrial.models.vessel.basis import Array
from tests.trials import composed, sailed

SHORT = (
    *("excitation.interval_s=5", "identifier=none", "evaluation=none", "disturbance=noise"),
    *("controller.feedforward=false", "controller.thruster_lead=false"),
)


@dataclass(frozen=True)
class Pid(PythonController):
    """The law of conf/controller/pid_ff.yaml without feedforward, in Python."""

    kp: tuple[float, ...]
    ki: tuple[float, ...]
    kd: tuple[float, ...]

    def design(self, model: Any, period_s: float) -> float:
        return period_s

    def start(self, design: float) -> Array:
        return np.zeros(3)

    def command(self, design: float, state: Array, now: Signals) -> Array:
        error = np.zeros(3)
        body_error_kernel(True, now.eta_d, now.eta, error)
        rate = now.nu_d - now.nu
        tau = np.array(self.kp) * error + np.array(self.ki) * state + np.array(self.kd) * rate
        state += design * error
        return np.asarray(tau)


@dataclass(frozen=True)
class Bad(PythonController):
    """Commands that cannot be used."""

    value: Any

    def command(self, design: Any, state: Any, now: Signals) -> Array:
        if self.value == "write":
            now.eta[0] = 1.0
        return self.value  # type: ignore[no-any-return]


def test_the_law_in_python_sails_as_the_compiled_one() -> None:
    trial = composed(*SHORT)
    pid: Any = trial.controller
    compiled = sailed(trial)
    readable = sailed(replace(trial, controller=Pid(pid.kp, pid.ki, pid.kd)))
    for name, one, other in zip(
        compiled.voyage.log._fields, compiled.voyage.log, readable.voyage.log, strict=True
    ):
        scale = np.max(np.abs(one)) + 1e-300
        np.testing.assert_allclose(other / scale, one / scale, atol=1e-9, err_msg=name)
    assert np.max(np.abs(compiled.voyage.log.eta)) > 1.0  # it did move


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ([np.nan, 0.0, 0.0], r"Bad\.command: got nan at \(0,\), expected finite numbers"),
        ([0.0, 0.0], r"Bad\.command: got shape \(2,\), expected \(3,\)"),
        (None, r"Bad\.command: got "),
        ("ahead", r"Bad\.command: got a str, expected \(3,\)"),
    ],
)
def test_a_command_that_cannot_be_used_is_refused(value: Any, message: str) -> None:
    with pytest.raises(PartError, match=message):
        sailed(replace(composed(*SHORT), controller=Bad(value)))


def test_the_log_cannot_be_changed() -> None:
    with pytest.raises(ValueError, match="read-only"):
        sailed(replace(composed(*SHORT), controller=Bad("write")))
