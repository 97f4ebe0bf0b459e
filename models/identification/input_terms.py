"""Terms of the inputs beside the devices: what a propeller, a rudder or a thruster does besides.

The devices of a vessel keep their nominal parameters. Where these are wrong, a table of the hull
alone has to make up for it, and cannot: hull forces do not know what the shaft does. Polynomials of
the inputs can, as in the models of Abkowitz (1964): thrust and its loss with speed are quadratic
forms of n and u, a rudder in the slipstream acts with the square of a speed between those of ship
and slipstream, a thruster by its command, in the directions in which its device pushes. The lateral
forces of a shaft are those of its asymmetry.
"""

import numpy as np

from seatrial.models.notation import DOFS
from seatrial.models.vessel.devices.device import device_forces
from seatrial.models.vessel.table import Vessel

SHAFT, ANGLE, SIGNAL = "n", "delta", "pwm"  # of which the names of inputs are made
AIR = {"surge": ("V_qu_q",), "sway": ("V_qv_q", "u_qv_q"), "yaw": ("V_qv_q", "u_qv_q")}


def input_labels(nominal: Vessel, windy: bool) -> list[str]:
    """Labels `dof.term` of what the inputs may do beside the devices.

    Args:
        nominal: the nominal model; one without devices has none, nor has one whose thrusters turn.
        windy: whether the wind was measured.
    """
    kinds = {name: name.partition("_")[0] for name in nominal.inputs}
    if not nominal.devices or not set(kinds.values()) <= {SHAFT, ANGLE, SIGNAL}:
        return []
    shafts = [name for name, kind in kinds.items() if kind == SHAFT]
    rest = np.zeros((len(kinds), len(nominal.dofs)))
    pushed = device_forces(
        nominal.installed, nominal.variables(rest, rest, inputs=np.eye(len(rest)))
    )
    terms: dict[str, list[str]] = {dof: [] for dof in nominal.dofs}
    for dof in terms:
        ahead = dof == "surge"
        for n in shafts:
            terms[dof] += [f"|{n}|{n}", f"{n}^2"]
            terms[dof] += [f"u{n}", f"u|{n}|"] if ahead else []
        for p, force in zip(kinds, pushed[:, DOFS.index(dof)], strict=True):
            if kinds[p] == SIGNAL and force != 0.0:
                terms[dof] += [p, f"|{p}|{p}", f"u{p}"]
        for d in (name for name, kind in kinds.items() if kind == ANGLE):
            speeds = [f"{n}^2" for n in shafts] + [f"|{n}|{n}" for n in shafts] or ["u^2"]
            if not ahead and shafts:
                speeds += [f"u{n}" for n in shafts] + [f"u|{n}|" for n in shafts]
            terms[dof] += [f"{speed}{d}^2" if ahead else f"{speed}{d}" for speed in speeds]
        terms[dof] += AIR.get(dof, ()) if windy else ()
    return [f"{dof}.{term}" for dof, own in terms.items() for term in own]
