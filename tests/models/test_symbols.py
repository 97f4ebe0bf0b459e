"""Expressions have the values of the equations that they were made from."""

import numpy as np
import pytest

from docs.vessels import parameters_of, vessels
from seatrial.models.errors import ConfigurationError
from seatrial.models.simulation.symbolic_rates import symbolic_rates
from seatrial.models.symbols import ENTRY, entries, evaluate, in_symbols
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.pose import kinematics_of

DIFFERENT = ("container", "kvlcc2", "supply_vessel")
OTHERS = tuple(name for name in vessels() if name not in DIFFERENT)
STATES = 300


def numbers(outputs: Array, arguments: dict[str, Array]) -> Array:
    """Values (n_outputs, N) for arguments (n, N)."""

    def apply(operation: str, operands: list[Array], uses: int) -> Array:
        if operation == ENTRY:
            name, index = operands
            return arguments[str(name)][int(index)]
        return np.asarray(getattr(np, operation)(*operands))

    return np.array([np.broadcast_to(one, STATES) for one in evaluate(list(outputs), apply)])


@pytest.mark.parametrize("names", [DIFFERENT, pytest.param(OTHERS, marks=pytest.mark.nightly)])
def test_the_accelerations_are_those_of_the_table_and_the_devices(
    names: tuple[str, ...], subtests: pytest.Subtests
) -> None:
    for name in names:
        with subtests.test(name):
            parameters, rng = parameters_of(name), np.random.default_rng(3)
            vessel, n = parameters.nominal(), len(parameters.dofs)
            kinematics = kinematics_of(vessel.dofs, "euler")
            _, nu_dot = symbolic_rates(kinematics, vessel.plant_table())
            speed = 0.3 * np.array(parameters.velocity_limits or parameters.scales.velocity_limits)
            eta, nu = rng.uniform(-1.0, 1.0, size=(n, STATES)), rng.normal(size=(n, STATES))
            nu *= speed[:, None]
            attitude, tau, acting = np.zeros((STATES, 3)), np.zeros((STATES, n)), None
            for k, dof in enumerate(("roll", "pitch", "yaw")):
                if dof in vessel.dofs:
                    attitude[:, k] = eta[vessel.dofs.index(dof)]
            if vessel.inputs:
                limits = np.array([parameters.input_low, parameters.input_high])
                acting = rng.uniform(*limits, size=(STATES, len(vessel.inputs)))
            else:
                tau = rng.normal(size=(STATES, n)) * vessel.inertia.diagonal()
            given = {"eta": eta, "nu": nu, "acting": (tau if acting is None else acting).T}
            still = np.zeros((2, STATES))
            found = numbers(nu_dot, given | {"wind": still, "current": still})
            expected = vessel.forward(tau, nu.T, attitude, inputs=acting).T
            scale = np.max(np.abs(expected), axis=1, keepdims=True)
            assert np.max(np.abs(found - expected) / np.maximum(scale, 1e-300)) < 1e-12


def test_equal_operations_are_one_symbol_and_what_has_no_effect_is_left_out() -> None:
    x, y = entries("x", 2)
    assert x * y + 1.0 is x * y + 1.0
    assert (1.0 * x + 0.0) - 0.0 * y is x
    assert 0.0 - x is -x
    assert entries("x", 1)[0] is x


def branching(x: float) -> float:
    return 1.0 if x > 0.0 else -1.0


def test_what_has_no_expression_is_named_with_its_place() -> None:
    (x,) = entries("x", 1)
    place = f"{__name__}, line {branching.__code__.co_firstlineno + 1}: got a branch"
    with pytest.raises(ConfigurationError, match=place):
        in_symbols(branching)(x)
    with pytest.raises(ConfigurationError, match=f"{__name__}, line .*the operation sinh"):
        np.sinh(x)
