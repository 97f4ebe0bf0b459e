"""Devices asked for what their data do not cover: how long and how far, and the unit of n."""

import logging

import numpy as np
import pytest

from docs.vessels import parameters_of
from seatrial.models.errors import ConfigurationError
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.devices.azimuth import Thruster
from seatrial.models.vessel.devices.device import doubts, excesses
from seatrial.models.vessel.table import Vessel
from seatrial.runner.trials import trial as trials
from tests.models.vessel.oracles import oracle_file
from tests.trials import STEERED, composed


def variables(vessel: Vessel, u: Array, *inputs: Array) -> Array:
    nu = np.column_stack([u, np.zeros((len(u), 2))])
    return vessel.variables(np.zeros_like(nu), nu, inputs=np.column_stack(inputs))


def test_what_is_outside_is_told_with_its_time_and_its_size() -> None:
    """J = u (1 - w_P0) / (n D) up to 0.77; a propeller that turns astern has no data."""
    ship, u = parameters_of("kvlcc2").nominal(), np.full(100, 1.0)
    n = np.where(np.arange(100) < 30, 2.5, np.where(np.arange(100) < 50, -3.0, 12.0))
    found = excesses(ship.devices, variables(ship, u, np.zeros(100), n), 0.5)
    assert [(one.name, one.seconds) for one in found] == [
        ("propeller.J", 15.0),
        ("propeller.n", 10.0),
    ]
    assert found[0].text == (
        "propeller: J up to 1.11, outside of its data (0 to 0.768) for 15 s of 50 s"
    )
    assert "n down to -3 1/s, outside of its data (0 or more) for 10 s of 50 s" in found[1].text


def test_nothing_is_told_of_a_ship_at_its_speed() -> None:
    ship = parameters_of("kvlcc2").nominal()
    x = variables(ship, np.full(9, 1.18), np.zeros(9), np.full(9, 11.85))
    assert excesses(ship.devices, x, 1.0) == []
    assert doubts(ship.devices, x) == []


def test_a_thruster_without_data_astern_is_told_and_gives_its_thrust_ahead() -> None:
    one_way = Thruster("n_1", 10.0, 0.0, 0.0)
    dofs = ("surge", "sway", "yaw")
    vessel = Vessel("one", dofs, (), np.zeros((0, 3)), inputs=("n_1",), devices={"it": one_way})
    x = variables(vessel, np.zeros(10), np.linspace(-1.0, 0.8, 10))
    (found,) = excesses(vessel.devices, x, 1.0)
    assert found.text.startswith("it: n_1 down to -1 1/s, outside of its data (0 or more) for 5 s")
    both = {"it": Thruster("n_1", 10.0, 0.0, 0.0, astern=10.0)}
    assert excesses(both, x, 1.0) == []
    assert np.all(one_way.values() == both["it"].values())


@pytest.mark.data
@pytest.mark.parametrize("run", ["14-Oct-2020_14_29_49", "14-Sep-2020_13_51_45"])
def test_revolutions_a_minute_are_doubted_in_a_recording(run: str) -> None:
    """As recorded in 1/s there is no doubt; times 60 there is."""
    file = oracle_file("").parent / "esso" / "turning" / f"turn_{run}.csv"
    rows = np.genfromtxt(file, delimiter=",", skip_header=1)
    ship = parameters_of("esso_osaka").nominal()
    for factor, count in ((1.0, 0), (60.0, 1)):
        found = doubts(ship.devices, variables(ship, rows[:, 2], rows[:, 8], factor * rows[:, 7]))
        assert len(found) == count
        assert all("is n in 1/min instead of 1/s?" in text for text in found)


def test_a_ship_configured_in_revolutions_a_minute_is_refused_with_the_reason() -> None:
    """Its steady speed is beyond what it can have; a sixtieth of n has one."""
    with pytest.raises(ConfigurationError, match="in 1/min") as refusal:
        composed(
            "vessel=kvlcc2", "vessel.inputs.n.high=1200", "vessel.inputs.n.start=711",
            "excitation=rudder_turn", "controller=none", "evaluation=none",
        )  # fmt: skip
    assert "\n" not in str(refusal.value)


def test_a_run_beyond_the_data_of_its_propeller_is_reported(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """A ship that starts at four times the speed of its shaft: J is too large until it slows."""
    trial = composed(
        "vessel=kvlcc2", "vessel.inputs.n.start=4", "excitation=rudder_turn",
        "excitation.speed_m_s=1.2", "excitation.duration_s=100", "controller=none",
        "evaluation=none", "identifier=none", "disturbance=calm",
    )  # fmt: skip
    trials.check(trial)
    with caplog.at_level(logging.WARNING):
        results = trials.run(trial)
    (row,) = [one for one in results.diagnostics if one.name == "outside"]
    assert row.unit == "s"
    assert 1.0 < (row.value or 0.0) < 100.0
    assert str(row.label).startswith("propeller: J up to 0.8")
    assert any("propeller: J up to" in record.message for record in caplog.records)


def test_parameters_of_devices_lie_within_their_bounds() -> None:
    """And the array that the kernels read is that of the options, in the order of the labels."""
    seen = set()
    for name in STEERED:
        vessel = parameters_of(name).nominal()
        values = dict(zip(vessel.installed.labels, vessel.installed.parameters, strict=True))
        for label, device in vessel.devices.items():
            seen.add(type(device))
            for parameter, bounds in device.PARAMETERS.items():
                where, value = f"{name}: {label}.{parameter}", values[f"{label}.{parameter}"]
                assert bounds.low <= value <= bounds.high, where
                assert value == getattr(device, parameter), where
            assert device.with_values(device.values().tolist()) == device, f"{name}: {label}"
    assert len(seen) > 5
