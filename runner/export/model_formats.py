"""The formats in which a stored model is written, and the writing of its files.

The linear model of a stored model is the one that was identified, or the tangent at a point. A file
is complete or not there: the contents are made first, written beside the places where they belong,
and moved there at the end.
"""

import io
import json
import os
import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np
import scipy.io

from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import POSES
from seatrial.models.simulation.linearisation import linearise, operating_force
from seatrial.models.simulation.statespace import StateSpace
from seatrial.models.vessel.basis import Array
from seatrial.runner.export import fmu, gazebo, stored_model
from seatrial.runner.export.equations import equations_of
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


NAME = re.compile(r"[A-Za-z]\w*", re.ASCII)  # of a function in C, MATLAB and Python
Files = Mapping[Path, str | bytes]


@dataclass(frozen=True)
class Request:
    """What is to be written: a model, and the path of the (first) file."""

    model: StoredModel
    path: Path
    at: str | None = None  # operating point of a linear model

    @property
    def symbol(self) -> str:
        """The stem of the file as the name of a function; raises ConfigurationError if it is none.

        A MATLAB function has the name of its file, and so have the C functions.
        """
        if NAME.fullmatch(self.path.stem) is None:
            raise ConfigurationError(
                f"--output: got {str(self.path)!r}, expected a name of letters, digits and _"
            )
        return self.path.stem


@dataclass(frozen=True)
class ModelFormat:
    """A format: the endings of its files, the usual one first, and the function that writes it."""

    endings: tuple[str, ...]
    files: Callable[[Request], Files]
    linear: bool = False  # whether it holds a linear model, which has an operating point
    inputs: bool = False  # whether it holds devices and their inputs as well


def _yaml(request: Request) -> Files:
    return {request.path: stored_model.as_yaml(request.model)}


def _json(request: Request) -> Files:
    return {request.path: stored_model.as_json(request.model)}


def _statespace(request: Request) -> Files:
    write_as = as_json if request.path.suffix == ".json" else as_mat
    return {request.path: write_as(request.model, request.at)}


def _python_control(request: Request) -> Files:
    model, description = linear_model(request.model, request.at)
    point = description.get("operating_point", "the identified state-space model")
    return {
        request.path: equations_of(request.model).in_angles.render(
            "control.py", name=request.symbol, linear=model,
            linear_source=f"linearised at {point}" if isinstance(point, dict) else point,
            states=list(states_of(request.model, model)),
            inputs=[f"tau_{dof}" for dof in request.model.table.dofs],
        )
    }  # fmt: skip


def _mss(request: Request) -> Files:
    equations = equations_of(request.model).in_angles
    return {request.path: equations.render("mss.m", name=request.symbol)}


def _pvs(request: Request) -> Files:
    model, equations = request.model, equations_of(request.model).in_angles
    start = [0.0] * len(equations.commands) if equations.lag is None else equations.lag.start
    length = model.parameters.scales.length_m
    text = equations.render("pvs.py", name=request.symbol, start=[*start], length=length)
    return {request.path: text}


def _gazebo(request: Request) -> Files:
    return {request.path: gazebo.sdf(request.model, "gazebo", request.symbol)}


def _vrx(request: Request) -> Files:
    return {request.path: gazebo.sdf(request.model, "vrx", request.symbol)}


def _c(request: Request) -> Files:
    equations, name = equations_of(request.model), request.symbol
    header = request.path.with_suffix(".h")
    return {
        request.path: equations.render("model.c", name=name),
        header: equations.render("model.h", name=name),
    }


def _fmu(request: Request) -> Files:
    equations = equations_of(request.model)
    return {request.path: fmu.fmu(equations, request.symbol, request.model.step_s)}


FORMATS: Mapping[str, ModelFormat] = {
    "yaml": ModelFormat((".yaml", ".yml"), _yaml, inputs=True),
    "json": ModelFormat((".json",), _json, inputs=True),
    "statespace": ModelFormat((".mat", ".json"), _statespace, linear=True),
    "python-control": ModelFormat((".py",), _python_control, linear=True),
    "mss": ModelFormat((".m",), _mss, inputs=True),
    "pvs": ModelFormat((".py",), _pvs, inputs=True),
    "gazebo": ModelFormat((".sdf",), _gazebo, inputs=True),
    "vrx": ModelFormat((".sdf",), _vrx, inputs=True),
    "c": ModelFormat((".c",), _c, inputs=True),
    "fmu": ModelFormat((".fmu",), _fmu, inputs=True),
}


def format_of(name: str) -> ModelFormat:
    """Return a format by its name; raises ConfigurationError if there is no such format."""
    if name not in FORMATS:
        raise ConfigurationError(f"--to: got {name!r}, expected one of {', '.join(FORMATS)}")
    return FORMATS[name]


def write(
    model: StoredModel, to: str, output: Path | None, at: str | None = None, force: bool = False
) -> list[Path]:
    """Write a model in a format; returns the paths.

    Args:
        model: the model of a run.
        to: name of the format, a key of `FORMATS`.
        output: path of the (first) file; None means the vessel's name in the working folder.
        at: operating point of a linear model, such as `u=0.5`.
        force: whether existing files are replaced.

    Raises:
        ConfigurationError: the format, path or operating point is wrong, a file exists, or the
            format cannot hold the devices and inputs of the vessel.
    """
    form = format_of(to)
    if output is None:
        output = Path(re.sub(r"\W", "_", model.name, flags=re.ASCII) + form.endings[0])
    if output.suffix not in form.endings:
        raise ConfigurationError(
            f"--output: got {str(output)!r}, expected a name that ends in "
            f"{' or '.join(form.endings)} for --to {to}"
        )
    if at is not None and not form.linear:
        linear_ones = " or ".join(name for name, form in FORMATS.items() if form.linear)
        raise ConfigurationError(f"--at: got --to {to}, expected --to {linear_ones}")
    model.parameters.nominal()  # raises for coefficients of which no vessel can be made
    if model.parameters.inputs and not form.inputs:
        whole = " or ".join(name for name, form in FORMATS.items() if form.inputs)
        raise ConfigurationError(
            f"--to {to}: got {model.name}, which is commanded by "
            f"{', '.join(model.parameters.inputs)}, expected a vessel by force; --to {whole} "
            "writes devices and inputs"
        )
    files = form.files(Request(model, output, at))
    _store(files, force)
    return list(files)


def _store(files: Files, force: bool) -> None:
    """Write all files or none; raises ConfigurationError if that is not possible."""
    parts = {path: path.with_name(f".{path.name}.{os.getpid()}") for path in files}
    try:
        existing = [path for path in files if not force and path.exists()]
        if existing:
            raise ConfigurationError(f"{existing[0]} exists, expected a new name or --force")
        for path, content in files.items():
            data = content if isinstance(content, bytes) else content.encode()
            parts[path].write_bytes(data)
        for path, part in parts.items():
            part.replace(path)
    except OSError as error:
        raise ConfigurationError(f"{next(iter(files))}: {error.strerror}") from error
    except ValueError as error:  # a name that no file can have
        raise ConfigurationError(f"--output: got {str(next(iter(files)))!r}: {error}") from error
    finally:
        for part in parts.values():
            with suppress(OSError, ValueError):
                part.unlink()
