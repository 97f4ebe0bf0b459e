"""The exported FMU is valid, and another program simulates it as we do."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.pose import Quaternion
from seatrial.runner.database import LogbookReader
from seatrial.runner.export.stored_model import read_model
from tests.runner.compare.conftest import Program
from tests.runner.compare.conftest import program as program
from tests.runner.export.compiled import Ours
from tests.runner.export.conftest import BELUGA, FERRY, SHIP, SUPPLY

STEPS, PERIOD, PARTS = 10_000, 0.1, 4  # a communication step is four integration steps
EQUAL = 1e-9
WIND, CURRENT = np.array([4.0, -7.0]), np.array([0.1, 0.2])


@pytest.fixture
def file(tmp_path: Path, sailed: Path, program: Program, request: pytest.FixtureRequest) -> Path:
    if shutil.which("cc") is None:
        pytest.skip("no C compiler: apt-get install gcc")
    run, model = request.param
    path = tmp_path / "vessel.fmu"
    words = ("--model", model, "-o", path, "--database", f"sqlite:///{sailed}/results/results.db")
    assert program("model", str(run), "--to", "fmu", *words) == (0, f"{path}\n", "")
    return path


@pytest.mark.parametrize(
    ("file", "run"),
    [((1, "identified"), 1), ((FERRY, "plant"), FERRY), ((SHIP, "identified"), SHIP),
     ((SUPPLY, "plant"), SUPPLY), ((BELUGA, "nominal"), BELUGA)],
    indirect=["file"],
)  # fmt: skip
def test_another_program_accepts_and_simulates_it(
    file: Path, run: int, sailed: Path, request: pytest.FixtureRequest
) -> None:
    pytest.importorskip("fmpy", reason="the extra fmu is not installed")
    from fmpy.validation import validate_fmu

    assert validate_fmu(str(file)) == []
    model = request.node.callspec.params["file"][1]
    with LogbookReader.read(f"sqlite:///{sailed}/results/results.db") as logbook:
        ours = Ours(read_model(logbook, run, model).parameters, WIND, CURRENT)
    limits = [ours.vessel.limits_by_dof[dof] for dof in ours.dofs]
    rng = np.random.default_rng(1)
    held = rng.uniform(-0.3, 0.3, size=(STEPS // 50, ours.n)) * limits
    if isinstance(ours.kinematics, Quaternion):
        held *= 0.1
    commands = np.repeat(held, 50, axis=0)
    track = ours.sail(commands, PERIOD, PARTS)[:, -ours.n :]
    assert np.all(np.isfinite(track))
    assert np.all(np.ptp(track, axis=0) > 0.0)
    theirs = simulated(file, commands)
    assert np.max(np.abs(theirs - track)) < EQUAL


def simulated(file: Path, commands: Array) -> Array:
    """Velocities after each communication step."""
    from fmpy import extract, read_model_description
    from fmpy.fmi2 import FMU2Slave

    description = read_model_description(str(file))
    where = {item.name: item.valueReference for item in description.modelVariables}
    slave = FMU2Slave(
        guid=description.guid, unzipDirectory=extract(str(file)), instanceName="ours",
        modelIdentifier=description.coSimulation.modelIdentifier,
    )  # fmt: skip
    slave.instantiate()
    slave.setupExperiment(startTime=0.0)
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    streams = [f"{what}_{way}" for what in ("wind", "current") for way in ("north", "east")]
    slave.setReal([where[name] for name in streams], [*WIND, *CURRENT])
    inputs = [where[name] for name in where if name.startswith("command_")]
    outputs = [where[name] for name in "uvwpqr" if name in where]
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
