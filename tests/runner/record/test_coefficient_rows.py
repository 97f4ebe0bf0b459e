"""Any run's model can be rebuilt from its coefficient rows and sailed again."""

from pathlib import Path

import numpy as np
import pytest

from seatrial.models.identification.problem import Identified
from seatrial.models.simulation.statespace import StateSpace
from seatrial.models.vessel.table import Vessel
from seatrial.runner.database import LogbookReader, LogbookWriter
from seatrial.runner.export.stored_model import read_model
from seatrial.runner.record.coefficient_rows import state_space_coefficients
from seatrial.runner.trials import trial as trials
from tests.runner.database.samples import make_start
from tests.trials import composed


def test_identified_devices_are_stored_with_units_and_sail(tmp_path: Path) -> None:
    """A rudder's parameter has a row with its standard error, and the stored vessel has it."""
    trial = composed(
        "vessel=kvlcc2", "excitation=rudder_zigzag", "excitation.duration_s=60", "controller=none",
        "evaluation=none", "identifier=output_error", "identifier.horizon=50",
        "identifier.free=[yaw.rU,rudder.a_H]", "identifier.horizons=[]", "disturbance=noise",
    )  # fmt: skip
    results = trials.run(trial)
    stored_rows = {(row.model, row.dof, row.term): row for row in results.coefficients}
    row = stored_rows["identified", "rudder", "a_H"]
    assert row.std_error is not None
    assert 0.0 < row.std_error < 0.1
    assert row.true_value == 0.312
    assert row.value not in (None, 0.312)
    assert stored_rows["identified", "propeller", "diameter_m"].unit == "m"
    assert stored_rows["identified", "propeller", "diameter_m"].std_error is None
    url = f"sqlite:///{tmp_path}/results.db"
    with LogbookWriter.open(url, results_dir=tmp_path) as logbook:
        begun = logbook.begin_run(make_start(config=trial.config, **trial.names))
        logbook.finish_run(begun.run_id, results)
    with LogbookReader.read(url, results_dir=tmp_path) as reader:
        model = read_model(reader, begun.run_id)
        values = {(r.dof, r.term): r.value for r in reader.coefficients(begun.run_id)
                  if r.model == "identified"}  # fmt: skip
    vessel = model.parameters.nominal()
    assert vessel.installed.labels == trial.vessel.nominal().installed.labels
    for label, value in zip(vessel.installed.labels, vessel.installed.parameters, strict=True):
        device, _, name = label.partition(".")
        assert value == values[device, name]
    assert vessel.coefficient("yaw", "rU") == pytest.approx(values["yaw", "rU"], rel=1e-15)
    assert model.table.inputs == ("delta", "n")
    nu, inputs = np.array([[1.1, 0.1, 0.05]]), np.array([[0.2, 11.0]])
    np.testing.assert_array_equal(
        vessel.forward(np.zeros((1, 3)), nu, inputs=inputs),
        model.table.forward(np.zeros((1, 3)), nu, inputs=inputs),
    )


def test_a_state_space_model_can_be_made_again_from_its_rows() -> None:
    rng = np.random.default_rng(0)
    shapes = {"A": (2, 2), "B": (2, 1), "C": (3, 2), "D": (3, 1), "K": (2, 3), "x0": (2,)}
    parts = {name: rng.normal(size=shape) for name, shape in shapes.items()}
    table = Vessel("none", ("surge",), (), np.zeros((0, 1)))
    model = StateSpace(**parts, period_s=0.5)
    rows = state_space_coefficients(Identified(table, table, state_space=model))
    again = {name: np.zeros(shape) for name, shape in shapes.items()}
    for row in rows:
        name, _, place = row.term.rstrip("]").partition("[")
        again[name][tuple(int(i) - 1 for i in place.split(","))] = row.value
    assert len(rows) == sum(part.size for part in parts.values())  # none of F
    for name, part in parts.items():
        np.testing.assert_array_equal(again[name], part)
    assert state_space_coefficients(Identified(table, table)) == []
