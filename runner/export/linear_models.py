"""Linear models of a stored model: the one that was identified, or the tangent at a point."""

import io
import json
from collections.abc import Mapping
from typing import cast

import numpy as np
import scipy.io

from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import POSES
from seatrial.models.simulation.linearisation import linearise, operating_force
from seatrial.models.simulation.statespace import StateSpace
from seatrial.models.vessel.basis import Array
from seatrial.runner.export.stored_model import StoredModel

WIND = ("wind_north", "wind_east")
MATRICES = ("A", "B", "C", "D", "K")


def linear_model(model: StoredModel, at: str | None) -> tuple[StateSpace, dict[str, object]]:
    """The linear model, and a description of what it is.

    It is the identified state-space model if there is one and no operating point is given, else the
    tangent at the operating point `at` (`u=0.5,psi=1.57,wind_north=5`), at rest by default.

    Raises ConfigurationError if the point names a variable that the vessel does not have.
    """
    if at is None and model.state_space is not None:
        return model.state_space, {"source": f"identified state-space model of {model.source}"}
    vessel = model.parameters.nominal()
    values = _point(at or "", vessel.velocities)
    nu = np.array([values.get(name, 0.0) for name in vessel.velocities])
    attitude = np.array([values.get(name, 0.0) for name in POSES[3:]])
    wind = np.array([values.get(name, 0.0) for name in WIND])
    linear = linearise(vessel, nu, attitude, wind)
    force = operating_force(vessel, nu, attitude, wind)
    return linear, {
        "source": f"{model.source}, linearised; deviations from the operating point",
        "operating_point": {
            "nu": nu.tolist(), "attitude": attitude.tolist(), "wind_ned": wind.tolist(),
            "tau": force.tolist(),
        },
    }  # fmt: skip


def states_of(model: StoredModel, linear: StateSpace) -> tuple[str, ...]:
    """Names of the states: pose and velocity of a tangent, x1, x2, ... of an identified model."""
    if linear is model.state_space:
        return tuple(f"x{i + 1}" for i in range(linear.order))
    return (*linear.outputs, *model.table.velocities)


def as_mat(model: StoredModel, at: str | None) -> bytes:
    """A MATLAB file with A, B, C, D, the names, and the period [s] (0: continuous time)."""
    content = _content(model, at)
    arrays = {key: _matlab(value) for key, value in content.items() if value is not None}
    file = io.BytesIO()
    scipy.io.savemat(file, arrays, oned_as="column")
    data = file.getvalue()
    head = b"MATLAB 5.0 MAT-file, seatrial"  # without the time of writing: equal files
    return head.ljust(116) + data[116:]


def as_json(model: StoredModel, at: str | None) -> str:
    """The same as data."""
    return json.dumps(_content(model, at), indent=1, ensure_ascii=False) + "\n"


def _content(model: StoredModel, at: str | None) -> dict[str, object]:
    linear, description = linear_model(model, at)
    matrices = {name: getattr(linear, name) for name in MATRICES}
    return {
        **{name: None if value is None else value.tolist() for name, value in matrices.items()},
        "period_s": linear.period_s or 0.0,
        "states": list(states_of(model, linear)),
        "inputs": list(linear.inputs),
        "outputs": list(linear.outputs),
        **description,
    }


def _matlab(value: object) -> object:
    """Lists of text as cells, mappings as structures, numbers as arrays."""
    if isinstance(value, Mapping):
        return {key: _matlab(item) for key, item in value.items()}
    if isinstance(value, list) and value and isinstance(value[0], str):
        return np.array(value, dtype=object)
    return cast(Array, np.array(value)) if isinstance(value, list) else value


def _point(text: str, velocities: tuple[str, ...]) -> dict[str, float]:
    """The values by name of an operating point."""
    known = (*velocities, *POSES[3:], *WIND)
    values = {}
    for part in filter(None, (part.strip() for part in text.split(","))):
        name, _, number = (word.strip() for word in part.partition("="))
        try:
            values[name] = float(number)
        except ValueError:
            values[name] = np.nan
        if name not in known or not np.isfinite(values[name]):
            raise ConfigurationError(
                f"--at: got {part!r}, expected NAME=NUMBER with a name of {', '.join(known)}"
            )
    return values
