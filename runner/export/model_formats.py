"""The formats in which a stored model is written, and the writing of its files.

A file is complete or not there: the contents are made first, written beside the places where they
belong, and moved there at the end.
"""

import os
import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from seatrial.models.errors import ConfigurationError
from seatrial.runner.export import fmu, gazebo, linear_models, stored_model
from seatrial.runner.export.equations import equations_of
from seatrial.runner.export.stored_model import StoredModel

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
    write_as = linear_models.as_json if request.path.suffix == ".json" else linear_models.as_mat
    return {request.path: write_as(request.model, request.at)}


def _python_control(request: Request) -> Files:
    model, description = linear_models.linear_model(request.model, request.at)
    point = description.get("operating_point", "the identified state-space model")
    return {
        request.path: equations_of(request.model).in_angles.render(
            "control.py", name=request.symbol, linear=model,
            linear_source=f"linearised at {point}" if isinstance(point, dict) else point,
            states=list(linear_models.states_of(request.model, model)),
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
