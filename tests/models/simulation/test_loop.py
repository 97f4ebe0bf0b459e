"""What the loop does for every controller: Python as compiled, held commands, another vessel."""

from typing import Any, NamedTuple

import numpy as np
import pytest

from seatrial.models.compiled import lean_kernel
from seatrial.models.control.controller import Controller, Model
from seatrial.models.errors import ConfigurationError
from seatrial.models.excitation.setpoints import Step
from seatrial.models.notation import PLANAR
from seatrial.models.simulation.loop import Watch, sail
from seatrial.models.simulation.registry import CONTROLLERS, Timetable
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.derivatives import from_derivatives
from seatrial.models.vessel.parameters import Plant
from tests.models.control.sailing import WINDAGE, appendix_k, lqi, ship, steady, voyage, weather


class Given(NamedTuple):
    """Commands given in advance; Python and compiled."""

    commands: Array


class GivenInPython(NamedTuple):
    commands: Array


def _give(
    table: Any, state: Array, eta: Array, nu: Array, eta_d: Array, nu_d: Array, nu_dot_d: Array,
    tau: Array, tau_fb: Array,
) -> None:  # fmt: skip
    k = int(state[0])
    state[0] += 1.0
    for i in range(tau.shape[0]):
        tau[i] = tau_fb[i] = table.commands[k, i]


CONTROLLERS[Given] = lean_kernel(_give)
CONTROLLERS[GivenInPython] = _give


class Commands(Controller):
    """A controller that says what it was told to."""

    def __init__(self, table: type, commands: Array) -> None:
        self.table, self.commands = table, commands

    def build(self, model: Model, period_s: float) -> tuple[Any, Array]:
        return self.table(self.commands), np.zeros(1)


@pytest.fixture(params=[Given, GivenInPython])
def table(request: pytest.FixtureRequest) -> type:
    kind: type = request.param
    return kind


def test_the_loop_in_python_is_the_compiled_loop() -> None:
    rng = np.random.default_rng(0)
    commands = rng.normal(size=(300, 3)) * [1e5, 1e5, 1e7]
    met = weather(300, wind_ned=steady(300, 12.0, 0.6), pose_noise=rng.normal(size=(300, 3)) * 0.1)
    logs = [
        voyage(Commands(kind, commands), np.zeros((300, 3)), met=met)[0].log
        for kind in (Given, GivenInPython)
    ]
    for compiled, readable in zip(*logs, strict=True):
        np.testing.assert_array_equal(compiled, readable)


def test_a_command_that_is_no_number_is_held_and_logged(table: type) -> None:
    commands = np.full((50, 3), 1e4)
    commands[10:13, 1] = np.nan
    commands[30, 0] = np.inf
    commands[0, 2] = np.nan
    log = voyage(Commands(table, commands), np.zeros((50, 3)))[0].log
    assert np.all(np.isfinite(log.tau))
    assert np.all(np.isfinite(log.eta))
    np.testing.assert_array_equal(np.flatnonzero(log.held[:, 0]), [0, 10, 11, 12, 30])
    np.testing.assert_array_equal(log.tau[0], 0.0)  # there was none before
    np.testing.assert_array_equal(log.tau[1:], 1e4)


def test_the_vessel_changes_when_it_is_told_to(table: type) -> None:
    heavy = from_derivatives("heavy", PLANAR, np.diag([4.8e7, 8e7, 9e10]), {}, False)
    light = from_derivatives("light", PLANAR, np.diag([2.4e7, 4e7, 4.5e10]), {}, False)
    controller = Commands(table, np.tile([2.4e5, 0.0, 0.0], (60, 1)))
    log = voyage(controller, np.zeros((60, 3)), plant=light, change=(30.0, heavy))[0].log
    np.testing.assert_allclose(log.nu_dot[1:30, 0], 0.01)
    np.testing.assert_allclose(log.nu_dot[30:, 0], 0.005)
    assert log.nu[59, 0] == pytest.approx(0.01 * 30 + 0.005 * 29)


def test_a_watch_may_change_parameters_between_its_instants(table: type) -> None:
    seen: list[int] = []

    def look(k: int, log: Any, parameters: Any, state: Any) -> Any:
        seen.append(k)
        assert np.all(log.tau[k:] == 0.0)  # nothing of the future
        return parameters._replace(commands=parameters.commands + 1e4)

    controller = Commands(table, np.zeros((100, 3)))
    log = voyage(controller, np.zeros((100, 3)), watch=Watch(30, look))[0].log
    assert seen == [30, 60, 90]
    np.testing.assert_array_equal(log.tau[:, 0], 1e4 * (np.arange(100) // 30))


def test_stretches_do_not_change_what_is_sailed() -> None:
    met, same = weather(400, wind_ned=steady(400, 8.0, 2.0)), ship() + WINDAGE.table(PLANAR)
    whole, _ = voyage(lqi(), appendix_k(400), met=met)
    cut = Watch(7, lambda k, log, parameters, state: parameters)
    pieces, _ = voyage(lqi(), appendix_k(400), met=met, watch=cut, change=(111.0, same))
    for one, other in zip(whole.log, pieces.log, strict=True):
        np.testing.assert_array_equal(one, other)


def test_what_is_no_command_of_the_vessel_is_refused() -> None:
    """Compiled code would write beyond the log."""
    calm, idle = weather(10, 3), (Given(np.zeros((10, 3))), np.zeros(1))
    guidance = (Timetable(np.zeros((10, 3))), np.zeros(1))
    for shape in ((10, 2), (9, 3)):
        with pytest.raises(ConfigurationError, match=f"added: got shape \\({shape[0]}, {shape[1]}"):
            sail(
                Plant(ship(), None, (20.0, 20.0, 1.0)), calm, guidance, Step().table(1.0), idle,
                np.zeros(3), 1.0, 1.0, added=np.zeros(shape),
            )  # fmt: skip
