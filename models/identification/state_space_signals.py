"""Which quantities of a recording can be the inputs and outputs of a state-space model."""

from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import ACCELERATIONS, VELOCITIES, poses_of
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import AIR, Term
from seatrial.models.vessel.table import Vessel


def check_signals(
    inputs: tuple[str, ...] | None, outputs: tuple[str, ...] | None, nominal: Vessel
) -> None:
    """Raise ConfigurationError for a signal that a recording of the vessel does not have."""
    own = {
        "inputs": tuple(f"tau_{dof}" for dof in nominal.dofs),
        "outputs": poses_of(nominal.dofs),
    }
    known = {"1", *nominal.velocities, *nominal.accelerations, *basis.ATTITUDE, *AIR}
    for option, values in (("inputs", inputs), ("outputs", outputs)):
        for value in set(values or ()) - set(own[option]):
            names = set() if value.startswith("tau_") else varying(value)
            if not names or not names <= known:
                raise ConfigurationError(
                    f"identifier.{option}: got {value}, expected {', '.join(own[option])} or terms "
                    f"that vary of the motion in {', '.join(nominal.dofs)}"
                )


def is_further_input(term: Term) -> bool:
    """Whether a term can be an additional input: it varies and is not already in the model."""
    names = varying(term.name)
    return bool(names) and not names & set(ACCELERATIONS) and term.name not in VELOCITIES


def varying(name: str) -> set[str]:
    """The variables in a term, without the constant."""
    return {basis.VARIABLES[code % basis.N_VARIABLES] for code in basis.term(name).codes if code}


def moves(term: Term) -> bool:
    """Whether a term contains a velocity; a term of the attitude alone is part of the stiffness."""
    return any(
        basis.VARIABLES[code % basis.N_VARIABLES] in (*VELOCITIES, *AIR) for code in term.codes
    )
