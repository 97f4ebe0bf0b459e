"""Models of steered vessels leave as vessels, with devices and inputs; other formats say no."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from omegaconf import OmegaConf

from docs.vessels import parameters_of
from seatrial.models.errors import ConfigurationError
from seatrial.models.vessel.parameters import VesselParameters
from seatrial.runner.configuration import options
from seatrial.runner.export.model_formats import FORMATS, write
from seatrial.runner.export.stored_model import StoredModel
from tests.trials import CONF

STEERED = [  # those that are written in one file
    path.stem for path in (CONF / "vessel").glob("*.yaml")
    if "\ninputs:" in path.read_text() and "\ndefaults:" not in path.read_text()
]  # fmt: skip


def stored(name: str) -> StoredModel:
    """An identified model of a run with the vessel: its coefficients times 0.9."""
    vessel = OmegaConf.to_container(OmegaConf.load(CONF / "vessel" / f"{name}.yaml"))
    groups = dict.fromkeys(("disturbance", "excitation", "identifier"), "none")
    summary = SimpleNamespace(run_id=7, vessel=name, seed=0, **groups)
    run: Any = SimpleNamespace(summary=summary, config={"vessel": vessel})
    return StoredModel(run, "identified", parameters_of(name).nominal() * 0.9)


def numbers(vessel: VesselParameters) -> dict[str, Any]:
    """Everything by which a simulation knows the vessel."""
    plant = vessel.nominal().plant_table()
    known = {"devices": vessel.devices, "inputs": vessel.inputs, "dofs": vessel.dofs}
    return known | {"entries": plant.entries, "inverse": plant.inverse_inertia}


def test_it_comes_back_to_the_last_digit(tmp_path: Path, subtests: pytest.Subtests) -> None:
    for name in sorted(STEERED):
        with subtests.test(name):
            model = stored(name)
            for form in ("yaml", "json"):
                (file,) = write(model, form, tmp_path / f"{name}.{form}")
                check_equal(file, model)


def check_equal(file: Path, model: StoredModel) -> None:
    """A file holds a model to the last digit."""
    again = options.part(VesselParameters, OmegaConf.to_container(OmegaConf.load(file)))
    assert isinstance(again, VesselParameters)
    for key, value in numbers(again).items():
        np.testing.assert_array_equal(value, numbers(model.parameters)[key], err_msg=key)
    table, own = again.nominal(), model.table
    found, wanted = (dict(zip(map(str, t.terms), t.theta, strict=True)) for t in (table, own))
    for term, row in wanted.items():
        np.testing.assert_array_equal(found.get(term, 0.0 * row), row)


def test_a_format_without_inputs_says_so(tmp_path: Path) -> None:
    model = stored("mariner")
    inputs = ", ".join(model.parameters.inputs)
    for to in (name for name, form in FORMATS.items() if not form.inputs):
        expected = f"--to {to}: got mariner_7, which is commanded by {inputs}, expected a vessel by"
        with pytest.raises(ConfigurationError, match=expected) as error:
            write(model, to, tmp_path / f"again{FORMATS[to].endings[0]}")
        assert "\n" not in str(error.value)
    assert list(tmp_path.iterdir()) == []
