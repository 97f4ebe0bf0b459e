"""A logbook of short trials whose models are exported, made by the command line once a session."""

from pathlib import Path

import pytest

from tests.runner.programs import ended, program

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
    code, out, err = ended(
        program("-m", "runner", "-m", "evaluation=none", *variants, folder=folder)
    )
    assert code == 0, (out, err)
    return folder
