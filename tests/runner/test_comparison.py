"""Every identifier in calm water, noise and a constant force: what it stores for figures."""

import io
from contextlib import chdir, redirect_stdout
from pathlib import Path

import pytest

from seatrial.runner.compare.__main__ import run as run_compare
from seatrial.runner.compare.plots import orders, pareto, spectrum, surface
from tests.runner.programs import program, rows

IDENTIFIERS = ("none", "ls", "ridge", "iv", "plsr", "surface_plsr", "output_error", "nsga2", "dsr")
DISTURBANCES = ("calm", "noise", "constant")

pytestmark = [pytest.mark.nightly, pytest.mark.timeout(1800)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the sweep was run; trials that fail are kept, so its exit code is not looked at."""
    place = tmp_path_factory.mktemp("comparison")
    sweep = program(
        "-m", "runner", "-m", f"identifier={','.join(IDENTIFIERS)}",
        f"disturbance={','.join(DISTURBANCES)}", "evaluation=none", folder=place,
    )  # fmt: skip
    sweep.communicate(timeout=1700)
    assert len(rows(place, "SELECT id FROM run")) == len(IDENTIFIERS) * len(DISTURBANCES)
    return place


def compare(folder: Path, *arguments: str) -> str:
    said = io.StringIO()
    with chdir(folder), redirect_stdout(said):
        assert run_compare(list(arguments)) == 0
    return said.getvalue()


def test_every_coefficient_that_was_estimated_has_its_standard_error(folder: Path) -> None:
    """An equation without any is the nominal one, to which nothing better was found."""
    found = rows(
        folder,
        "SELECT identifier, count(*), count(one.std_error), sum(one.value = nominal.value) "
        "FROM coefficient AS one JOIN run ON run.id = one.run_id "
        "JOIN coefficient AS nominal USING (run_id, term, dof) "
        "WHERE one.model = 'identified' AND nominal.model = 'nominal' AND one.value <> 0 "
        "GROUP BY one.run_id, one.dof",
    )
    assert len(found) > 60
    for identifier, many, known, nominal in found:
        assert known == many or (known, nominal) == (0, many), identifier
        if identifier == "output_error":
            assert known == many


def test_the_figures_find_what_they_draw(folder: Path) -> None:
    stored = {name for (name,) in rows(folder, "SELECT DISTINCT name FROM diagnostic")}
    wanted = {pareto.OBJECTIVE, pareto.CHOSEN, spectrum.SINGULAR, spectrum.ORDER, spectrum.REAL}
    wanted |= {spectrum.IMAGINARY, surface.SURFACE, surface.VARIABLES, *orders.NAMES}
    assert wanted <= stored
    for kind in ("pareto", "surface", "spectrum", "orders", "coefficients"):
        assert ".png" in compare(folder, "plot", kind)
