"""The exported FMU is valid, and another program simulates it as we do."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from docs.vessels import parameters_of
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.pose import Quaternion
from seatrial.runner.database import LogbookReader
from seatrial.runner.export.equations import Equations
from seatrial.runner.export.fmu import fmu
from seatrial.runner.export.stored_model import read_model
from tests.runner.compare.conftest import Program
from tests.runner.compare.conftest import program as program
from tests.runner.export.compiled import Ours
from tests.runner.export.conftest import BELUGA, FERRY
from tests.runner.export.test_steered import STEERED

STEPS, PERIOD, PARTS = 10_000, 0.1, 4  # a communication step is four integration steps
EQUAL = 1e-9
WIND, CURRENT = np.array([4.0, -7.0]), np.array([0.1, 0.2])
OTHERS = tuple(name for name in STEERED if name != "kvlcc2")


@pytest.mark.parametrize(("run", "model"), [(FERRY, "plant"), (BELUGA, "nominal")])
def test_another_program_accepts_and_simulates_it(
    run: int, model: str, tmp_path: Path, sailed: Path, program: Program
) -> None:
    if shutil.which("cc") is None:
        pytest.skip("no C compiler: apt-get install gcc")
    path, database = tmp_path / "vessel.fmu", f"sqlite:///{sailed}/results/results.db"
    words = ("--model", model, "-o", path, "--database", database)
    assert program("model", str(run), "--to", "fmu", *words) == (0, f"{path}\n", "")
    with LogbookReader.read(database) as logbook:
        ours = Ours(read_model(logbook, run, model).parameters, WIND, CURRENT)
    share = 0.03 if isinstance(ours.kinematics, Quaternion) else 0.3
    check_alike(path, ours, ours.random_commands(STEPS, share))


@pytest.mark.parametrize("names", [("kvlcc2",), pytest.param(OTHERS, marks=pytest.mark.nightly)])
def test_vessels_with_inputs_leave_with_their_devices(
    names: tuple[str, ...], tmp_path: Path, subtests: pytest.Subtests
) -> None:
    if shutil.which("cc") is None:
        pytest.skip("no C compiler: apt-get install gcc")
    for name in names:
        with subtests.test(name):
            vessel = parameters_of(name)
            equations = Equations(vessel.nominal(), vessel.thruster, name, vessel.inputs)
            path = tmp_path / f"{name}.fmu"
            path.write_bytes(fmu(equations, name, PERIOD / PARTS))
            ours = Ours(vessel, WIND, CURRENT)
            check_alike(path, ours, ours.random_commands(STEPS))


def check_alike(file: Path, ours: Ours, commands: Array) -> None:
    """An FMU is valid, and has our velocities after each step."""
    pytest.importorskip("fmpy", reason="the extra fmu is not installed")
    from fmpy.validation import validate_fmu

    assert validate_fmu(str(file)) == []
    track = ours.sail(commands, PERIOD, PARTS)[:, -ours.n :]
    assert np.all(np.isfinite(track))
    assert np.any(np.ptp(track, axis=0) > 0.0)
    assert np.max(np.abs(simulated(file, ours, commands) - track)) < EQUAL


def simulated(file: Path, ours: Ours, commands: Array) -> Array:
    """Velocities after each communication step."""
    from fmpy import extract, read_model_description
    from fmpy.fmi2 import FMU2Slave

    description = read_model_description(str(file))
    where = {item.name: item.valueReference for item in description.modelVariables}
    slave = FMU2Slave(
        guid=description.guid, unzipDirectory=extract(str(file)), instanceName="ours",
        modelIdentifier=description.coSimulation.modelIdentifier,
    )  # fmt: skip
    outputs = [where[name] for name in "uvwpqr" if name in where]
    inputs = [where[name] for name in where if name.startswith("command_")]
    slave.instantiate()
    slave.setupExperiment(startTime=0.0)
    assert slave.getReal(inputs) == list(ours.start)
    slave.setReal([where[f"start_{name}"] for name in "uvwpqr" if name in where], [*ours.nu_start])
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    streams = [f"{what}_{way}" for what in ("wind", "current") for way in ("north", "east")]
    slave.setReal([where[name] for name in streams], [*WIND, *CURRENT])
    track = np.empty((len(commands), len(outputs)))
    for k, command in enumerate(commands):
        slave.setReal(inputs, list(command))
        slave.doStep(currentCommunicationPoint=k * PERIOD, communicationStepSize=PERIOD)
        track[k] = slave.getReal(outputs)
    slave.terminate()
    slave.freeInstance()
    return track


def test_without_a_compiler_it_is_one_line(
    sailed: Path, tmp_path: Path, program: Program, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    database = f"sqlite:///{sailed}/results/results.db"
    code, out, err = program(
        "model", "1", "--to", "fmu", "-o", tmp_path / "x.fmu", "--database", database
    )
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "--to fmu: there is no C compiler, expected one of cc, gcc, clang in PATH" in err
    assert list(tmp_path.iterdir()) == []
