"""The parameters for Gazebo and VRX give our forces in the equations of their documentation."""

import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from seatrial.models.notation import ACCELERATIONS, DOFS, VELOCITIES
from seatrial.models.vessel.basis import Array
from seatrial.runner.export.gazebo import parameters_of, sdf, thrusts
from seatrial.runner.export.stored_model import StoredModel
from tests.runner.export.conftest import FERRY, Exporter
from tests.runner.export.test_steered import stored

FLIP = np.array([1.0, -1.0, -1.0, 1.0, -1.0, -1.0])  # to port and up instead of starboard and down
N = 40


def moving(name: str) -> StoredModel:
    """A model, with a random motion in place of its recording."""
    model, rng = stored(name), np.random.default_rng(2)
    vessel = model.parameters
    motion = {"t": np.arange(N), "psi": rng.normal(size=N)}
    for names in (model.table.velocities, model.table.accelerations, vessel.inputs):
        motion |= {one: rng.normal(size=N) for one in names}
    return replace(model, motion=lambda: motion)


def columns(motion: dict[str, Array], names: tuple[str, ...]) -> Array:
    """Columns (N, 6) of a motion; those that it does not have are zero."""
    return np.array([motion.get(name, np.zeros(N)) for name in names]).T


def gazebo(read: dict[str, float], nu: Array, nu_dot: Array) -> Array:
    """Hydrodynamics.hh of gz-sim: the wrench of each sample (N, 6), without Coriolis forces."""
    force = np.zeros((N, 6))
    for i, axis in enumerate("xyzkmn"):
        for j, first in enumerate("UVWPQR"):
            force[:, i] += read.get(f"{axis}Dot{first}", 0.0) * nu_dot[:, j]
            force[:, i] += read.get(f"{axis}{first}", 0.0) * nu[:, j]
            for k, second in enumerate("UVWPQR"):
                size = read.get(f"{axis}{first}abs{second}", 0.0) * np.abs(nu[:, k])
                signed = read.get(f"{axis}{first}{second}", 0.0) * nu[:, k]
                force[:, i] += (size + signed) * nu[:, j]
    return force


def vrx(read: dict[str, float], nu: Array, nu_dot: Array) -> Array:
    """SimpleHydrodynamics.hh of VRX: likewise, with its defaults for the axes that are left out."""
    force = np.zeros((N, 6))
    for i, (axis, speed) in enumerate(zip("xyzkmn", "UVWPQR", strict=True)):
        drag = read.get(f"{axis}{speed}", 20.0)
        drag = drag + read.get(f"{axis}{speed}{speed}", 0.0) * np.abs(nu[:, i])
        force[:, i] = -read.get(f"{axis}Dot{speed}", 5.0) * nu_dot[:, i] - drag * nu[:, i]
    return force


def rigid(mass: float, inertia: Array, nu: Array, nu_dot: Array) -> Array:
    """Newton and Euler: the force (N, 6) that a rigid body needs about its centre of gravity."""
    v, w = nu[:, :3], nu[:, 3:]
    linear = mass * (nu_dot[:, :3] + np.cross(w, v))
    return np.hstack([linear, inertia * nu_dot[:, 3:] + np.cross(w, inertia * w)])


@pytest.mark.parametrize("target", [gazebo, vrx])
@pytest.mark.parametrize(
    "name", ["milliampere", "beluga_full", "otter", "mariner", "container", "surge_nonlinear"]
)
def test_the_plugin_needs_our_force_without_what_is_named(name: str, target: object) -> None:
    model, to = moving(name), target.__name__
    motion, table = model.motion(), replace(model.parameters.nominal(), devices={})
    tree = ElementTree.fromstring(sdf(model, to, "boat"))
    plugin = tree.find("model/plugin")
    read = {one.tag: float(one.text) for one in plugin if one.text[-1].isdigit()}
    link = tree.find("model/link/inertial")
    inertia = np.array([float(link.find(f"inertia/{key}").text) for key in ("ixx", "iyy", "izz")])
    nu, nu_dot = (FLIP * columns(motion, names) for names in (VELOCITIES, ACCELERATIONS))
    needed = rigid(float(link.find("mass").text), inertia, nu, nu_dot) - target(read, nu, nu_dot)
    _, lost = parameters_of(to, model.parameters, motion)
    for one in lost:
        if " of " not in one.name:
            needed[:, "XYZKMN".index(one.name[0])] += FLIP["XYZKMN".index(one.name[0])] * one.force
    attitude = columns(motion, ("phi", "theta", "psi"))
    inputs = np.array([motion[one] for one in table.inputs]).T if table.inputs else None
    indices = [DOFS.index(dof) for dof in table.dofs]
    x = nu[:, indices] * FLIP[indices], nu_dot[:, indices] * FLIP[indices]
    ours = table.inverse(x[1], x[0], attitude, None, inputs)
    scale = np.max(np.abs(ours), axis=0)
    assert np.max(np.abs((needed * FLIP)[:, indices] - ours) / scale) < 1e-9


def test_what_is_lost_is_named_with_its_force(subtests: pytest.Subtests) -> None:
    for name, target, expected in (
        ("milliampere", "gazebo", {"X_u^3", "Y_v^3"}),
        ("milliampere", "vrx", {"X_vr", "N_uv", "Y_r_dot"}),
        ("otter", "gazebo", {"Y of cross_flow", "N of cross_flow"}),
        ("kvlcc2", "vrx", {"X of propeller", "N of rudder", "X_vr"}),
        ("mariner", "gazebo", {"N_v^3/U"}),
    ):
        with subtests.test(name=name, target=target):
            model = moving(name)
            names = {one.name for one in parameters_of(target, model.parameters, model.motion())[1]}
            assert expected <= names, names
            text = sdf(model, target, "boat")
            assert all(f"at the recording: {one}: " in text for one in names)


@pytest.mark.slow
def test_a_stored_run_gives_the_motion_of_its_recording(export: Exporter) -> None:
    file = export(FERRY, "vrx", "ferry.sdf")
    assert ElementTree.parse(file).getroot().find("model").get("name") == "ferry"
    assert re.search(r"not in vrx, .* at the recording: X_vr: [\d.]+\n", file.read_text())


def test_thrusters_stand_where_they_push() -> None:
    model = moving("milliampere_azimuths")
    tree = ElementTree.fromstring(sdf(model, "gazebo", "boat"))
    joints = {one.text for one in tree.iterfind("model/plugin/joint_name")}
    for thrust in thrusts(model.parameters):
        assert thrust.turns
        assert {f"{thrust.name}_joint", f"{thrust.name}_azimuth_joint"} <= joints
        link = tree.find(f"model/link[@name='{thrust.name}']/pose")
        assert tuple(map(float, link.text.split()[:3])) == thrust.place
