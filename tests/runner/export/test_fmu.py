"""The exported FMU is valid, and another program simulates it as we do."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from docs.vessels import parameters_of
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.pose import Quaternion
from seatrial.runner.export.equations import Equations
from seatrial.runner.export.fmu import fmu
from tests.runner.command import Command
from tests.runner.compare.conftest import Program
from tests.runner.export.compiled import CURRENT, WIND, Ours
from tests.runner.export.conftest import BELUGA, FERRY, Exporter
from tests.runner.export.test_steered import STEERED

STEPS, PERIOD, PARTS = 10_000, 0.1, 4  # a communication step is four integration steps
EQUAL = 1e-9
OTHERS = tuple(name for name in STEERED if name != "kvlcc2")
needs_compiler = pytest.mark.skipif(
    shutil.which("cc") is None, reason="no C compiler: apt-get install gcc"
)


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize(("run", "model"), [(FERRY, "plant"), (BELUGA, "nominal")])
def test_the_model_of_a_run_leaves_by_the_command_line(
    export: Exporter, run: int, model: str
) -> None:
    ours = Ours(export.vessel(run, model), WIND, CURRENT)
    check_alike(export(run, "fmu", "vessel.fmu", "--model", model), ours)


@needs_compiler
@pytest.mark.parametrize(
    "names",
    [("milliampere", "beluga_full", "kvlcc2"), pytest.param(OTHERS, marks=pytest.mark.nightly)],
)
def test_another_program_accepts_and_simulates_it(
    names: tuple[str, ...], tmp_path: Path, subtests: pytest.Subtests
) -> None:
    """Vessels by force with three and six degrees of freedom, and with devices and their inputs."""
    for name in names:
        with subtests.test(name):
            vessel = parameters_of(name)
            equations = Equations(vessel.nominal(), vessel.thruster, name, vessel.inputs)
            path = tmp_path / f"{name}.fmu"
            path.write_bytes(fmu(equations, name, PERIOD / PARTS))
            check_alike(path, Ours(vessel, WIND, CURRENT))


def check_alike(file: Path, ours: Ours) -> None:
    """An FMU is valid, and in two other programs has our velocities after each step."""
    pytest.importorskip("fmpy", reason="the extra fmu is not installed")
    from fmpy.validation import validate_fmu

    assert validate_fmu(str(file)) == []
    share = 0.03 if isinstance(ours.kinematics, Quaternion) and not ours.vessel.inputs else 0.3
    commands = ours.random_commands(STEPS, share)
    track = ours.sail(commands, PERIOD, PARTS)[:, -ours.n :]
    assert np.all(np.isfinite(track))
    assert np.any(np.ptp(track, axis=0) > 0.0)
    for simulated in (by_fmpy, by_libcosim):
        assert np.max(np.abs(simulated(file, ours, commands) - track)) < EQUAL


def by_fmpy(file: Path, ours: Ours, commands: Array) -> Array:
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


def by_libcosim(file: Path, ours: Ours, commands: Array) -> Array:
    """Velocities after each communication step; DNV's Open Simulation Platform."""
    pytest.importorskip("libcosimpy", reason="the extra test is not installed")
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
    from libcosimpy.CosimManipulator import CosimManipulator
    from libcosimpy.CosimObserver import CosimObserver
    from libcosimpy.CosimSlave import CosimLocalSlave

    log_output_level(CosimLogLevel.ERROR)
    execution = CosimExecution.from_step_size(round(1e9 * PERIOD))
    slave = execution.add_local_slave(CosimLocalSlave(str(file), "ours"))
    given, seen = CosimManipulator.create_override(), CosimObserver.create_last_value()
    execution.add_manipulator(given)
    execution.add_observer(seen)
    where = {item.name.decode(): item.reference for item in execution.slave_variables(slave)}
    outputs = [where[name] for name in "uvwpqr" if name in where]
    inputs = [where[name] for name in where if name.startswith("command_")]
    for name, start in zip([n for n in "uvwpqr" if n in where], ours.nu_start, strict=True):
        execution.real_initial_value(slave, where[f"start_{name}"], float(start))
    streams = [where[f"{what}_{way}"] for what in ("wind", "current") for way in ("north", "east")]
    given.slave_real_values(slave, streams, [*WIND, *CURRENT])
    track = np.empty((len(commands), len(outputs)))
    for k, command in enumerate(commands):
        given.slave_real_values(slave, inputs, list(command))
        execution.step()
        track[k] = seen.last_real_values(slave, outputs)
    return track


def test_without_a_compiler_it_is_one_line(
    seatrial: Command, program: Program, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    trial = ("vessel=surge_linear", "excitation=prbs", "excitation.length_s=10", "identifier=none")
    assert seatrial(*trial, "controller=none", "evaluation=none").code == 0
    before = sorted(tmp_path.iterdir())
    monkeypatch.setenv("PATH", str(tmp_path))
    code, out, err = program("model", "1", "--to", "fmu", "-o", tmp_path / "x.fmu")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "--to fmu: there is no C compiler, expected one of cc, gcc, clang in PATH" in err
    assert sorted(tmp_path.iterdir()) == before
