"""A stored model as an FMU: FMI 2.0 for co-simulation, compiled from the exported C.

The archive holds the model description, a library for this machine and its sources. Inputs are the
commands, forces or inputs of the vessel, the wind and the current; outputs pose, velocity, and the
forces or inputs that act.
"""

import io
import platform
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path
from tempfile import TemporaryDirectory
from uuid import NAMESPACE_URL, uuid5
from xml.etree import ElementTree

from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import POSE_UNIT, VELOCITY_UNIT, poses_of
from seatrial.runner.export.equations import Equations

PLATFORM = "linux64"  # folder of the library, as FMI 2.0 names it
COMPILERS = ("cc", "gcc", "clang")
# Exponents of the base units of what the variables are measured in.
UNITS = {
    "N": {"kg": "1", "m": "1", "s": "-2"}, "Nm": {"kg": "1", "m": "2", "s": "-2"},
    "m": {"m": "1"}, "rad": {"rad": "1"}, "m/s": {"m": "1", "s": "-1"},
    "rad/s": {"rad": "1", "s": "-1"}, "s": {"s": "1"}, "1/s": {"s": "-1"}, "1": {},
}  # fmt: skip
KINDS = {
    "input": {"variability": "continuous"},
    "parameter": {"variability": "fixed", "initial": "exact"},
    "output": {"variability": "continuous", "initial": "calculated"},
}


def fmu(equations: Equations, name: str, step_s: float) -> bytes:
    """The archive; `step_s` [s] is the longest integration step.

    Raises ConfigurationError if this machine has no C compiler, or is not Linux on x86-64.
    """
    code = {f"{name}.{end}": equations.render(f"model.{end}", name=name) for end in ("c", "h")}
    guid = str(uuid5(NAMESPACE_URL, f"{step_s!r}{code}"))
    sources = code | {
        f"{name}_fmi2.c": equations.render("fmu.c", name=name, guid=guid, step=step_s)
    }
    contents: dict[str, str | bytes] = {
        "modelDescription.xml": _description(equations, name, guid, step_s),
        f"binaries/{PLATFORM}/{name}.so": _compiled(sources),
        **{f"sources/{file}": text for file, text in sources.items()},
    }
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as file:
        for path, content in contents.items():  # with the time of zip's beginning: equal files
            file.writestr(zipfile.ZipInfo(path), content, zipfile.ZIP_DEFLATED)
    return archive.getvalue()


def _compiled(sources: dict[str, str]) -> bytes:
    """The library of the sources."""
    here = f"{sys.platform} on {platform.machine()}"
    if here != "linux on x86_64":
        raise ConfigurationError(f"--to fmu: got {here}, expected linux on x86_64")
    compiler = next(filter(None, map(shutil.which, COMPILERS)), None)
    if compiler is None:
        raise ConfigurationError(
            f"--to fmu: there is no C compiler, expected one of {', '.join(COMPILERS)} in PATH"
        )
    with TemporaryDirectory(prefix="seatrial-") as folder:
        for file, text in sources.items():
            (Path(folder) / file).write_text(text)
        files = [file for file in sources if file.endswith(".c")]
        flags = ("-std=c99", "-O2", "-fPIC", "-shared", "-o", "library.so")
        done = subprocess.run(
            [compiler, *flags, *files, "-lm"],
            cwd=folder, capture_output=True, text=True, check=False,
        )  # fmt: skip
        if done.returncode:
            reason = " ".join(done.stderr.split())
            raise ConfigurationError(f"--to fmu: {compiler} failed: {reason[:200]}")
        return (Path(folder) / "library.so").read_bytes()


def _description(equations: Equations, name: str, guid: str, step_s: float) -> bytes:
    """The file modelDescription.xml."""
    root = ElementTree.Element(
        "fmiModelDescription", fmiVersion="2.0", modelName=name, guid=guid,
        description=equations.source, generationTool="seatrial",
        variableNamingConvention="flat", numberOfEventIndicators="0",
    )  # fmt: skip
    simulation = ElementTree.SubElement(
        root, "CoSimulation", modelIdentifier=name,
        canHandleVariableCommunicationStepSize="true",
    )  # fmt: skip
    files = ElementTree.SubElement(simulation, "SourceFiles")
    for file in (f"{name}.c", f"{name}_fmi2.c"):
        ElementTree.SubElement(files, "File", name=file)
    units = ElementTree.SubElement(root, "UnitDefinitions")
    for unit, exponents in UNITS.items():
        node = ElementTree.SubElement(units, "Unit", name=unit)
        ElementTree.SubElement(node, "BaseUnit", exponents)
    ElementTree.SubElement(
        root, "DefaultExperiment", startTime="0.0", stopTime="600.0", stepSize=repr(step_s)
    )
    variables = ElementTree.SubElement(root, "ModelVariables")
    outputs = []
    starts = {"integration_step": step_s}
    if equations.lag:
        commands = (f"command_{name}" for name in equations.commands)
        starts |= zip(commands, equations.lag.start, strict=True)
    for reference, (variable, unit, causality) in enumerate(_variables(equations)):
        attributes = {"name": variable, "valueReference": str(reference), "causality": causality}
        node = ElementTree.SubElement(variables, "ScalarVariable", attributes | KINDS[causality])
        real = {"unit": unit}
        if causality == "output":
            outputs.append(str(reference + 1))
        else:
            real["start"] = repr(float(starts.get(variable, 0.0)))
        ElementTree.SubElement(node, "Real", real)
    structure = ElementTree.SubElement(root, "ModelStructure")
    for part in ("Outputs", "InitialUnknowns"):
        listed = ElementTree.SubElement(structure, part)
        for index in outputs:
            ElementTree.SubElement(listed, "Unknown", index=index)
    ElementTree.indent(root)
    return bytes(ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True))


def _variables(equations: Equations) -> list[tuple[str, str, str]]:
    """Name, unit and causality of every variable, in the order of the value references."""
    dofs, poses = equations.vessel.dofs, poses_of(equations.vessel.dofs)
    velocities = equations.vessel.velocities
    streams = [f"{what}_{way}" for what in ("wind", "current") for way in ("north", "east")]
    commands = equations.commands.items()
    start = [(f"start_{pose}", POSE_UNIT[dof]) for pose, dof in zip(poses, dofs, strict=True)]
    start += [(f"start_{u}", VELOCITY_UNIT[dof]) for u, dof in zip(velocities, dofs, strict=True)]
    reached = [(name.removeprefix("start_"), unit) for name, unit in start]
    acts = "acting" if equations.inputs else "force"
    reached += [(f"{acts}_{name}", unit) for name, unit in commands]
    return [
        *((f"command_{name}", unit, "input") for name, unit in commands),
        *((name, "m/s", "input") for name in streams),
        ("integration_step", "s", "parameter"),
        *((name, unit, "parameter") for name, unit in start),
        *((name, unit, "output") for name, unit in reached),
    ]
