"""A logbook of short trials whose models are exported, made by the command line once a session."""

from pathlib import Path

import pytest

from seatrial.models.vessel.parameters import VesselParameters
from seatrial.runner.database import LogbookReader
from seatrial.runner.export.stored_model import read_model
from tests.runner import programs
from tests.runner.compare.conftest import Program
from tests.runner.compare.conftest import program as program

# Runs 1, 2, ... of the logbook.
TRIALS = (
    ("surge_linear", "identifier=ls", "excitation=prbs", "controller=none"),
    ("milliampere", "identifier=ls", "disturbance=wind_current"),
    ("modulus_ship", "identifier=ls"),
    ("supply_vessel", "identifier=ridge", "disturbance=wind"),
    ("beluga_full", "identifier=none", "excitation=multisine", "controller=none"),
    ("surge_linear", "identifier=dsr", "excitation=prbs", "controller=none"),
    ("beluga_diagonal", "identifier=none", "excitation=multisine", "controller=none"),
)
FERRY, SHIP, SUPPLY, BELUGA, LINEAR, DIAGONAL = 2, 3, 4, 5, 6, 7


@pytest.fixture(scope="session")
def sailed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the logbook: results/results.db."""
    folder = tmp_path_factory.mktemp("export")
    variants = [
        word
        for vessel, *options in TRIALS
        for word in ("--variant", " ".join([f"vessel={vessel}", *options]))
    ]
    started = programs.program("-m", "runner", "-m", "evaluation=none", *variants, folder=folder)
    code, out, err = programs.ended(started)
    assert code == 0, (out, err)
    return folder


class Exporter:
    """Writes models of the logbook into a folder."""

    def __init__(self, sailed: Path, folder: Path, program: Program) -> None:
        self.database = f"sqlite:///{sailed}/results/results.db"
        self.folder, self.program = folder, program

    def __call__(self, run: int, to: str, name: str, *words: str) -> Path:
        """Export a run; the path of the file."""
        file = self.folder / name
        where = ("--to", to, "-o", file, "--database", self.database)
        written = [file, file.with_suffix(".h")] if to == "c" else [file]
        said = "".join(f"{path}\n" for path in written)
        assert self.program("model", str(run), *where, *words) == (0, said, "")
        return file

    def vessel(self, run: int, model: str) -> VesselParameters:
        """The vessel of a run's model."""
        with LogbookReader.read(self.database) as logbook:
            return read_model(logbook, run, model).parameters


@pytest.fixture
def export(sailed: Path, tmp_path: Path, program: Program) -> Exporter:
    return Exporter(sailed, tmp_path, program)
