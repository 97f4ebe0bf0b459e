"""The interface of a controller: its options, the step built from a model, and its design data."""

from abc import ABC, abstractmethod
from typing import ClassVar

from seatrial.models.errors import ConfigurationError
from seatrial.models.findings import Finding
from seatrial.models.simulation.registry import Parameters, State
from seatrial.models.simulation.statespace import StateSpace
from seatrial.models.simulation.voyage import Log, Outlook
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

    def remarks(self, model: Model, period_s: float) -> list[Finding]:
        """Findings about the design; a `spectral_radius` of 1 or more gives a warning."""
        return []


def table_of(model: Model) -> Vessel:
    """The model as a coefficient table; raises ConfigurationError for a state-space model."""
    if isinstance(model, StateSpace):
        raise ConfigurationError(
            "controller: got a state-space model, expected a table of coefficients"
        )
    return model
