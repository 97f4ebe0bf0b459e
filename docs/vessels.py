"""The table of vessels in docs/reference/vessels.md: `python -m docs.vessels`.

It is generated from `conf/vessel`, whose files give the source of every number.
"""

from functools import cache
from pathlib import Path

import numpy as np
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from seatrial.models.notation import DOFS
from seatrial.models.vessel.parameters import VesselParameters
from seatrial.runner.configuration.config import build_as

CONF = Path(__file__).parents[1] / "conf"
HEADERS = (
    "vessel", "degrees of freedom", "kinematics", "coefficients", "where its numbers come from",
)  # fmt: skip


def vessels() -> list[str]:
    """The names of all options of the group `vessel`."""
    return sorted(path.stem for path in (CONF / "vessel").glob("*.yaml"))


@cache
def parameters_of(name: str) -> VesselParameters:
    """The parameters of a vessel, as configured."""
    with initialize_config_dir(str(CONF), version_base="1.3"):
        config = compose("trial", [f"vessel={name}"])
        node = OmegaConf.to_container(config.vessel, resolve=True)
    made = build_as(object, node, "vessel")
    assert isinstance(made, VesselParameters)
    return made


def kinematics(vessel: VesselParameters) -> str:
    """The kinematics of a vessel: the relation between velocity and pose."""
    if vessel.planar:
        return "R(psi)"
    return f"{vessel.attitude}s" if vessel.dofs == DOFS else "along its axis"


def counts(vessel: VesselParameters) -> tuple[int, int]:
    """The numbers of nonzero hydrodynamic derivatives and of nonzero coefficients."""
    derivatives = vessel.derivatives | vessel.parameter_sets.get(vessel.parameters or "", {})
    known = sum(value != 0.0 for value in derivatives.values())
    return known, int(np.count_nonzero(vessel.nominal().theta))


def row(name: str) -> list[str]:
    """The table cells of one vessel."""
    vessel = parameters_of(name)
    known, whole = counts(vessel)
    dofs = "all six" if vessel.dofs == DOFS else ", ".join(vessel.dofs)
    sources = "<br>".join(f"{entry}: {source}" for entry, source in vessel.sources.items())
    of_them = f"{known} derivative{'' if known == 1 else 's'}"
    return [f"`{name}`", dofs, kinematics(vessel), f"{whole} ({of_them})", sources]


def table() -> str:
    """The complete table in Markdown."""
    rows = [list(HEADERS), ["---"] * len(HEADERS), *map(row, vessels())]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in rows)


if __name__ == "__main__":
    print(f"\n{table()}")
