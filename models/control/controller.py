"""The interface of a controller: its options, the step built from a model, and its design data.

Controllers whose step is ordinary Python; the closed loop then runs in Python with them.
"""

from abc import ABC, abstractmethod
from typing import Any, ClassVar, NamedTuple

import numpy as np

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError
from seatrial.models.returned import checked_array
from seatrial.models.simulation.registry import CONTROLLERS, Parameters, State
from seatrial.models.simulation.statespace import StateSpace
from seatrial.models.simulation.voyage import Log, Outlook
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel

Model = Vessel | StateSpace


class Controller(ABC):
    """Frozen options of a controller.

    `build` returns the parameters of a step function registered in `CONTROLLERS`.
    `takes_state_space` is true if the controller accepts an identified state-space model in place
    of a coefficient table. `period_s` [s] is the period of the control loop.
    """

    takes_state_space: ClassVar[bool] = False
    commands_inputs: ClassVar[bool] = False  # of a vessel; otherwise forces on its axes

    @abstractmethod
    def build(self, model: Model, period_s: float) -> tuple[Parameters, State]:
        """Parameters and initial state of the registered step.

        Raises ConfigurationError where the model and the options do not fit.
        """

    def deployed(self) -> "Controller":
        """The controller used in an evaluation; by default this one."""
        return self

    def foresee(self, parameters: Parameters, outlook: Outlook) -> Parameters:
        """The parameters with the known part of the weather and the mission."""
        return parameters

    def adapt(
        self, parameters: Parameters, state: State, model: Vessel, period_s: float,
        outlook: Outlook, log: Log, k: int,
    ) -> Parameters:  # fmt: skip
        """Parameters for a new model during a simulation, before instant k; the state is kept."""
        return self.foresee(self.build(model, period_s)[0], outlook)

    def command_rows(self, period_s: float) -> int:
        """Number of loop instants between two commands."""
        return 1

    def preview_rows(self, period_s: float) -> int:
        """Number of loop instants by which a step of the reference is known in advance."""
        return 0

    def command_limits(self) -> tuple[float, ...] | None:
        """Limits [N, Nm] of the commands, one per degree of freedom; None: no limits."""
        return None

    def failures(self, state: State) -> int:
        """Number of samples at which no command could be computed and the last one was held."""
        return 0

    def findings(self, state: State) -> list[Diagnostic]:
        """What the state tells of a voyage that has ended."""
        return []

    def diagnostics(self, model: Model, period_s: float) -> list[Diagnostic]:
        """Diagnostics about the design; a `spectral_radius` of 1 or more gives a warning."""
        return []


def table_of(model: Model) -> Vessel:
    """The model as a coefficient table; raises ConfigurationError for a state-space model."""
    if isinstance(model, StateSpace):
        raise ConfigurationError(
            "controller: got a state-space model, expected a table of coefficients"
        )
    return model


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
