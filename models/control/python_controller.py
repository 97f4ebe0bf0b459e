"""Controllers whose step is ordinary Python; the closed loop then runs in Python with them."""

from abc import abstractmethod
from typing import Any, NamedTuple

import numpy as np

from seatrial.models.control.controller import Controller, Model
from seatrial.models.returned import checked_array
from seatrial.models.simulation.registry import CONTROLLERS, Parameters, State
from seatrial.models.vessel.basis import Array


class Signals(NamedTuple):
    """What a controller knows at an instant: arrays of shape (n_dof,), SI units, read-only."""

    eta: Array  # measured pose
    nu: Array  # measured body velocity
    eta_d: Array  # filtered reference of these, and its acceleration
    nu_d: Array
    nu_dot_d: Array


class PythonController(Controller):
    """A controller whose commands are computed in Python, without a compiled step.

    `design` is called once for a model, `start` once for a voyage, `command` at every instant.
    """

    def design(self, model: Model, period_s: float) -> object:
        """What the commands need of the model, such as gains; by default the model."""
        return model

    def start(self, design: Any) -> Any:
        """The state before the first command, an object that `command` may change; or None."""
        return None

    @abstractmethod
    def command(self, design: Any, state: Any, now: Signals) -> Array:
        """The force in body axes [N, Nm], shape (n_dof,)."""

    def build(self, model: Model, period_s: float) -> tuple[Parameters, State]:
        """The design and the initial state, for the loop in Python."""
        design = self.design(model, period_s)
        return PythonTable(self, design), self.start(design)


class PythonTable(NamedTuple):
    """Parameters of the step: the controller and its design."""

    controller: PythonController
    design: Any


def _step(
    table: PythonTable, state: State, eta: Array, nu: Array, eta_d: Array, nu_d: Array,
    nu_dot_d: Array, tau: Array, tau_fb: Array,
) -> None:  # fmt: skip
    """Write the command; all of it counts as feedback."""
    now = Signals(*map(_read_only, (eta, nu, eta_d, nu_d, nu_dot_d)))
    command = table.controller.command(table.design, state, now)
    tau[:] = checked_array(table.controller, "command", command, tau.shape)
    tau_fb[:] = tau


def _read_only(values: Array) -> Array:
    """A view of a row of the log, which a controller must not change."""
    view: Array = np.asarray(values).view()
    view.flags.writeable = False
    return view


CONTROLLERS[PythonTable] = _step
