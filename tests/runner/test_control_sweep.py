"""Every controller on two vessels in five disturbances, from the command line to a table."""

import math

import numpy as np
import pytest

from seatrial.models.notation import DOFS
from seatrial.runner.compare.cli import TableOptions
from seatrial.runner.compare.comparison_table import comparison
from seatrial.runner.compare.results import open_results
from seatrial.runner.compare.selection import request_of
from seatrial.runner.database import LogbookWriter
from tests.runner.command import Command

DATABASE = "sqlite:///results/results.db"
SWEEP = (
    "vessel=supply_vessel,milliampere",
    "controller=pid_ff,lqi,mpc_standard,mpc_reduced,mpc_condensed,mpc_integral",
    "disturbance=calm,noise,constant,wind,rough", "identifier=none",
)  # fmt: skip
SHORT = (
    "evaluation=station_keeping", "evaluation.duration_s=20", "excitation=prbs",
    "excitation.length_s=3", "sample_time_s=0.5", "integration_step_s=0.1",
)  # fmt: skip


def table(metric: str, dof: str) -> dict[str, list[float]]:
    """A metric by vessel and controller over the disturbances, as `runner.compare table`."""
    options = TableOptions(
        rows="vessel,controller", columns="disturbance", metric=[metric], dof=[dof],
        model=["nominal"],
    )  # fmt: skip
    with open_results(DATABASE) as results:
        grid = comparison(results, request_of(options))
    return {
        f"{row[0].text} {row[1].text}": [
            math.nan if cell.sort is None else cell.sort for cell in row[2:]
        ]
        for row in grid.rows
    }


@pytest.mark.nightly
def test_every_cell_of_the_table_is_filled(seatrial: Command) -> None:
    """Sixty trials, short ones; a position is kept within two metres and ten degrees."""
    answer = seatrial("-m", *SWEEP, *SHORT)
    assert answer.code == 0, answer.err
    for metric, dof, most in (("e_pos_mae", "position", 2.0), ("e_psi_mae", "heading", 10.0)):
        found = table(metric, dof)
        assert len(found) == 12
        assert np.all(np.array(list(found.values())) < most)  # and none is not a number
    assert np.all(np.array(list(table("failures", "all").values())) == 0.0)
    assert np.all(np.array(list(table("held_commands", "all").values())) == 0.0)
    with LogbookWriter.read(DATABASE) as logbook:
        runs = logbook.runs()
        assert [run.status for run in runs] == ["finished"] * 60
        for run in runs:
            sailed = logbook.series(run.run_id, "deployment_nominal").columns
            forces = [sailed[f"tau_{dof}"] for dof in DOFS if f"tau_{dof}" in sailed]
            assert np.all(np.isfinite(forces))
