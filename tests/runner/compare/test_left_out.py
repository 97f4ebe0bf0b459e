"""Single runs that are newer than the sweep of a table are named, not silently left out."""

from tests.runner.command import Command
from tests.runner.compare.conftest import Program


def test_a_table_names_the_runs_that_are_newer_than_its_sweep(
    seatrial: Command, program: Program
) -> None:
    seatrial.pretend()
    table = ("table", "--metric", "force_mse")
    assert seatrial("-m", "seed=0,1").code == 0
    assert program(*table)[2] == ""
    assert seatrial("seed=2").code == 0
    _, out, hint = program(*table)
    assert "2 runs" in out
    assert hint == "1 newer run is of no sweep and left out: --sweep all\n"
    _, out, hint = program(*table, "--sweep", "all")
    assert ("3 runs" in out, hint) == (True, "")
    assert program(*table, "--where", "id=3")[2] == ""
