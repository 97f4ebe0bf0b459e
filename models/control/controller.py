"""What every controller is asked: a step built on a model, and what is known of it beforehand."""

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
    """Frozen options of a controller; the step that `build` gives parameters for is registered.

    `takes_state_space`: an identified state-space model is taken in place of its table. Times
    `period_s` [s] are those of the loop.
    """

    takes_state_space: ClassVar[bool] = False

    @abstractmethod
    def build(self, model: Model, period_s: float) -> tuple[Parameters, State]:
        """Parameters and initial state of the registered step.

        Raises ConfigurationError where the model and the options do not fit.
        """

    def deployed(self) -> "Controller":
        """What sails an evaluation."""
        return self

    def foresee(self, parameters: Parameters, outlook: Outlook) -> Parameters:
        """The parameters with what can be known of the weather and the mission."""
        return parameters

    def adapt(
        self, parameters: Parameters, state: State, model: Vessel, period_s: float,
        outlook: Outlook, log: Log, k: int,
    ) -> Parameters:  # fmt: skip
        """Parameters for another model while sailing, before instant k; the state goes on."""
        return self.foresee(self.build(model, period_s)[0], outlook)

    def command_rows(self, period_s: float) -> int:
        """Loop instants from one command to the next."""
        return 1

    def preview_rows(self, period_s: float) -> int:
        """Loop instants that a following step of the reference is known before it."""
        return 0

    def command_limits(self) -> tuple[float, ...] | None:
        """Limits [N, Nm] that its commands keep, one a degree of freedom; None: it keeps none."""
        return None

    def failures(self, state: State) -> int:
        """Commands that it could not compute, and held."""
        return 0

    def remarks(self, model: Model, period_s: float) -> list[Finding]:
        """What it says of its design on a model; `spectral_radius` is warned of from 1 on."""
        return []


def table_of(model: Model) -> Vessel:
    """The coefficient table that a controller is built on; refuses a state-space model."""
    if isinstance(model, StateSpace):
        raise ConfigurationError(
            "controller: got a state-space model, expected a table of coefficients"
        )
    return model
