"""Forces allocated to the inputs of devices, and dynamic positioning by them."""

from dataclasses import replace

import numpy as np
import pytest

from seatrial.models.notation import PLANAR
from seatrial.models.simulation.voyage import Log, Voyage
from seatrial.models.vessel.allocation import DeviceAllocation, allocate_step, thrust_at
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.devices.device import device_forces
from seatrial.models.vessel.parameters import VesselParameters
from seatrial.runner.trials import deployment_metrics
from seatrial.runner.trials.checks import check
from tests.models.control.sailing import weather
from tests.trials import composed, sailed

POSITIONED = ("milliampere_azimuths", "osv")
PLAIN = ("excitation=rudder_prbs", "identifier=none", "controller=none", "evaluation=none")


def vessel(name: str) -> VesselParameters:
    return composed(f"vessel={name}", *PLAIN).vessel


def allocation(name: str) -> DeviceAllocation:
    found = vessel(name).positioning
    assert found is not None
    return found


def made(name: str, inputs: Array) -> Array:
    """Force [N, Nm] that the devices themselves give at rest under inputs (N, n_inputs)."""
    ship = vessel(name).nominal()
    still = np.zeros((len(inputs), 3))
    x = ship.variables(still, still, inputs=inputs)
    return device_forces(ship.installed, x)[:, [0, 1, 5]]


def demands(name: str, share: float, count: int = 200) -> Array:
    """Forces in all directions, their components up to a share of what each axis can have."""
    rng = np.random.default_rng(0)
    limits = np.array(allocation(name).limits(PLANAR))
    return share * limits * rng.uniform(-1.0, 1.0, (count, 3))


@pytest.mark.parametrize("name", POSITIONED)
def test_devices_give_the_demanded_force(name: str) -> None:
    """Inside the attainable set, and with every input within its limits."""
    table, ship, tau = allocation(name).table(PLANAR), vessel(name), demands(name, 0.3)
    inputs = np.empty((len(tau), len(ship.inputs)))
    for k in range(len(tau)):
        allocate_step(table, tau[k], inputs[k])
    size = np.array(allocation(name).limits(PLANAR))
    np.testing.assert_allclose(made(name, inputs) / size, tau / size, atol=2e-3)  # idle azimuths
    assert np.all(inputs >= np.array(ship.input_low) - 1e-12)
    assert np.all(inputs <= np.array(ship.input_high) + 1e-12)


@pytest.mark.parametrize("name", POSITIONED)
def test_the_faces_hold_all_forces_of_the_thrusters_and_touch_them(name: str) -> None:
    """By thrusts at their limits: at random directions, and along the normal of each face."""
    forces, limits = allocation(name).forces(), np.array(allocation(name).limits(PLANAR))
    faces, table = forces.faces(PLANAR, limits), forces.table(PLANAR)
    normals = np.vstack([np.sign(faces), np.random.default_rng(0).normal(size=(500, 3))]) / limits
    reached = np.zeros((len(normals), 3))
    for low, high, T in zip(
        table.low, table.high, np.split(table.T.T, table.first[1:-1]), strict=True
    ):
        along = normals @ T.T
        size = np.maximum(np.linalg.norm(along, axis=1), 1e-300)
        astern = (along[:, 0] < 0.0) & (len(T) == 1)
        reached += (np.where(astern, -low, high) / size)[:, None] * along @ T
    share = reached / limits @ faces.T
    assert np.max(share) < 1.0 + 1e-12
    np.testing.assert_allclose(np.diag(share), 1.0)


@pytest.mark.parametrize("name", POSITIONED)
def test_what_cannot_be_reached_keeps_its_direction(name: str) -> None:
    table, ship = allocation(name).table(PLANAR), vessel(name)
    size = np.array(allocation(name).limits(PLANAR))
    for tau in demands(name, 20.0, 40):
        inputs = np.empty(len(ship.inputs))
        allocate_step(table, tau, inputs)
        force = made(name, inputs[None])[0] / size
        cosine = force @ (tau / size) / np.linalg.norm(force) / np.linalg.norm(tau / size)
        assert cosine > 1.0 - 1e-4
        assert np.max(np.abs(force)) < 2.0


def test_the_limits_of_axes_are_those_of_the_thrusters() -> None:
    """milliAmpere: four azimuths ahead; on a moment alone each acts across its arm."""
    surge, sway, yaw = allocation("milliampere_azimuths").limits(PLANAR)
    assert surge == pytest.approx(4.0 * 260.0, rel=1e-6)
    assert sway == pytest.approx(4.0 * 260.0, rel=1e-6)
    assert yaw == pytest.approx(4.0 * 260.0 * np.hypot(1.8, 0.8), rel=1e-6)


def test_an_azimuth_turns_the_short_way() -> None:
    """From ahead to astern it reverses, and does not turn by half a circle."""
    table, ship = allocation("milliampere_azimuths").table(PLANAR), vessel("milliampere_azimuths")
    azimuths = [i for i, name in enumerate(ship.inputs) if name.startswith("alpha")]
    inputs = np.empty(len(ship.inputs))
    for surge in (200.0, -200.0):
        allocate_step(table, np.array([surge, 0.0, 0.0]), inputs)
        np.testing.assert_allclose(inputs[azimuths], 0.0, atol=1e-9)
        assert made("milliampere_azimuths", inputs[None])[0] == pytest.approx([surge, 0.0, 0.0])


def narrowed(name: str, half_rad: float) -> VesselParameters:
    """The vessel with azimuths that turn by so much to each side."""
    ship = vessel(name)
    inputs = {
        key: replace(one, low=-half_rad, high=half_rad) if key.startswith("alpha") else one
        for key, one in ship.inputs.items()
    }
    return replace(ship, inputs=inputs)


def test_an_azimuth_of_half_a_circle_gives_what_it_gives_ahead_and_astern() -> None:
    """Every force within the limits is given, in every direction, with azimuths in their range."""
    own = narrowed("milliampere_azimuths", 1.57).positioning
    assert own is not None
    tau = 0.5 * np.array(own.limits(PLANAR)) * np.random.default_rng(0).uniform(-1, 1, (200, 3))
    tau[:2] = (0.0, 300.0, 0.0), (0.0, -300.0, 0.0)
    table, inputs = own.table(PLANAR), np.empty((len(tau), 8))
    for k in range(len(tau)):
        allocate_step(table, tau[k], inputs[k])
    azimuths = [i for i, name in enumerate(own.inputs) if name.startswith("alpha")]
    assert np.max(np.abs(inputs[:, azimuths])) <= 1.57
    given = made("milliampere_azimuths", inputs)
    np.testing.assert_allclose(given / own.limits(PLANAR), tau / own.limits(PLANAR), atol=2e-3)


def test_an_azimuth_of_less_does_not_position_a_vessel() -> None:
    assert narrowed("milliampere_azimuths", 1.5).positioning is None


def test_curves_are_inverted() -> None:
    """A dead band and a curve between linear and quadratic."""
    first = replace(allocation("milliampere_azimuths").devices[0], dead_band=0.1, curvature=0.4)
    own = allocation("milliampere_azimuths")
    bent = replace(own, devices=(first, *own.devices[1:]))
    table, inputs = bent.table(PLANAR), np.empty(8)
    allocate_step(table, np.array([300.0, 0.0, 0.0]), inputs)
    assert thrust_at(first, inputs[0]) == pytest.approx(table.forces.u[0], rel=1e-9)


@pytest.mark.parametrize("name", ["otter", "kvlcc2", "remus100", "blueboat"])
def test_what_gives_no_force_on_every_axis_is_not_positioned(name: str) -> None:
    assert vessel(name).positioning is None


def test_the_share_of_forces_beyond_the_devices_is_counted() -> None:
    """Of four commands the two beyond the bollard pull of an axis."""
    own = allocation("milliampere_azimuths")
    tau = np.array([[100.0, 0.0, 0.0], [0.0, 1.01, 0.0], [0.0, 0.0, -3.0], [0.0, 0.5, 0.0]])
    tau[1:] *= own.limits(PLANAR)
    rows = {name: np.zeros((4, 3)) for name in Log._fields}
    voyage = Voyage(
        np.arange(4.0), Log(**{**rows, "tau": tau}), PLANAR, weather(4),
        inputs=vessel("milliampere_azimuths").input_names, allocation=own,
    )  # fmt: skip
    assert deployment_metrics.unreached(voyage) == 0.5


@pytest.mark.nightly
@pytest.mark.parametrize("name", POSITIONED)
@pytest.mark.parametrize("controller", ["pid_ff", "lqi"])
def test_station_is_kept_in_a_constant_force(name: str, controller: str) -> None:
    """Within a tenth of the length and five degrees at the end, by the devices alone."""
    trial = composed(
        f"vessel={name}", "excitation=prbs", "identifier=none", f"controller={controller}",
        "evaluation=station_keeping", "disturbance=constant",
    )  # fmt: skip
    check(trial)
    voyage = sailed(trial, trial.evaluation, deployed=True).voyage
    assert voyage.positioned
    last = voyage.log.eta[-len(voyage.t) // 5 :]
    length = trial.vessel.length_m
    assert length is not None
    assert np.max(np.hypot(last[:, 0], last[:, 1])) < 0.1 * length
    assert np.max(np.abs(np.degrees(last[:, 2]))) < 5.0
    assert np.all(voyage.log.tau_actual >= np.array(trial.vessel.input_low) - 1e-9)
