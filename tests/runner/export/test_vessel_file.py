"""A stored model as a vessel: written, read again, and sailed, all by the command line."""

import shutil
import sqlite3
from pathlib import Path

import numpy as np
import pytest
from omegaconf import OmegaConf

from seatrial.models.vessel.parameters import VesselParameters
from seatrial.runner.configuration import options
from seatrial.runner.database import LogbookReader
from seatrial.runner.record.coefficient_rows import vessel_of
from tests.runner.command import Command
from tests.runner.compare.conftest import Program
from tests.runner.export.conftest import BELUGA, FERRY, LINEAR, SUPPLY
from tests.runner.programs import ended, rows
from tests.runner.programs import program as process

pytestmark = pytest.mark.slow
COEFFICIENTS = "SELECT term, dof, value FROM coefficient WHERE run_id={} AND model='{}' ORDER BY id"


@pytest.fixture
def here(sailed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a copy of the logbook, which is the working folder."""
    shutil.copytree(sailed / "results", tmp_path / "results")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def coefficients(folder: Path, run: int, model: str) -> dict[tuple[object, object], object]:
    found = rows(folder, COEFFICIENTS.format(run, model))
    return {(term, dof): value for term, dof, value in found if value}


@pytest.mark.parametrize(
    ("run", "model", "form"),
    [(FERRY, "identified", "json"), (FERRY, "plant", "yaml"), (FERRY, "nominal", "yaml"),
     (SUPPLY, "identified", "yaml"), (BELUGA, "identified", "yaml"),
     (LINEAR, "identified", "json")],
)  # fmt: skip
def test_every_coefficient_comes_back_to_the_last_digit(
    here: Path, program: Program, run: int, model: str, form: str
) -> None:
    output = here / f"again.{form}"
    code, out, err = program("model", str(run), "--to", form, "--model", model, "--output", output)
    assert (code, out, err) == (0, f"{output}\n", "")
    node = OmegaConf.to_container(OmegaConf.load(output))  # as Hydra reads it
    assert isinstance(node, dict)
    with LogbookReader.read(f"sqlite:///{here}/results/results.db") as logbook:
        stored = vessel_of([r for r in logbook.coefficients(run) if r.model == model], model)
        config = logbook.run(run).config["vessel"]
    vessel = options.part(VesselParameters, node)
    assert isinstance(vessel, VesselParameters)
    table = vessel.nominal()
    assert table.dofs == stored.dofs
    for term in {*table.terms, *stored.terms}:
        assert np.array_equal(table.row(term.name), stored.row(term.name)), term
    assert isinstance(config, dict)
    same = ("thruster", "thrusters", "force_limits", "velocity_limits", "tuning", "integrator")
    assert {key: node.get(key) for key in same} == {key: config.get(key) for key in same}
    assert node["plant_scale"] == (config["plant_scale"] if model == "nominal" else 1.0)


def test_a_run_and_its_file_are_sailed_alike(
    seatrial: Command, here: Path, program: Program
) -> None:
    assert program("model", str(FERRY), "--to", "yaml", "-o", "ferry.yaml")[0] == 0
    (here / "vessels").mkdir()
    shutil.copy(here / "ferry.yaml", here / "vessels")
    chosen = f"vessel=run:{FERRY},ferry.yaml,vessels/ferry.yaml,{here}/vessels/ferry.yaml"
    words = ("-m", chosen, "identifier=ls", "disturbance=noise", "seed=3")
    answer = seatrial(*words)
    assert answer.code == 0, answer
    ids = [run for (run,) in rows(here, "SELECT id FROM run WHERE seed = 3 ORDER BY id")]
    assert len(ids) == 4
    identified = coefficients(here, FERRY, "identified")
    for run in ids:
        assert isinstance(run, int)
        assert coefficients(here, run, "nominal") == identified
        assert coefficients(here, run, "plant") == identified
    query = (
        "SELECT stage, model, dof, name, value FROM metric "
        "WHERE run_id={} AND name NOT LIKE 'step_time%' ORDER BY id"
    )
    metrics = [rows(here, query.format(run)) for run in ids]
    assert len(metrics[0]) > 50
    assert all(others == metrics[0] for others in metrics)


@pytest.mark.nightly
def test_workers_read_a_run_as_well(here: Path) -> None:
    words = (f"vessel=run:{FERRY}", "seed=5,6", "hydra/launcher=processes", "evaluation=none")
    code, out, err = ended(process("-m", "runner", "-m", *words, folder=here))
    assert code == 0, (out, err)
    names = rows(here, "SELECT vessel, status FROM run WHERE seed IN (5, 6)")
    assert names == [(f"run:{FERRY}", "finished")] * 2


def test_a_vessel_that_is_not_there_is_one_line(
    seatrial: Command, here: Path, subtests: pytest.Subtests
) -> None:
    (here / "broken.yaml").write_text("name: [1\n")
    for words, expected in (
        (("vessel=run:99",), "results.db: there is no run 99"),
        (("vessel=run:1", "results_dir=other"), "other/results.db: there is no logbook"),
        (("vessel=run:x",), "vessel: no option 'run:x'"),
        (("vessel=absent.yaml",), "vessel: there is no file absent.yaml"),
        (("vessel=broken.yaml",), "broken.yaml, line 2: "),
    ):
        for mode in ((), ("-m",)):
            with subtests.test(words=words, mode=mode):
                answer = seatrial(*mode, *words)
                assert (answer.code, answer.out, answer.err.count("\n")) == (2, "", 1)
                assert expected in answer.err


def test_a_model_that_cannot_be_written_is_one_line(
    here: Path, program: Program, subtests: pytest.Subtests
) -> None:
    (here / "there.yaml").write_text("mine")
    before = sorted(here.iterdir())
    for words, expected in (
        (["99", "--to", "yaml"], "there is no run 99"),
        (["1", "--to", "xml"], "--to: got 'xml', expected one of yaml, json"),
        (["1", "--to", "yaml", "-o", "m.json"], "--output: got 'm.json', expected a name"),
        (["1", "--to", "yaml", "-o", "absent/m.yaml"], "No such file or directory"),
        (["1", "--to", "yaml", "-o", "there.yaml"], "there.yaml exists, expected a new name or"),
        (["1", "--to", "yaml", "--model", "adaptive"],
         "run 1 (finished) has no model 'adaptive', expected one of nominal, identified, plant"),
    ):  # fmt: skip
        with subtests.test(words=words):
            code, out, err = program("model", *words)
            assert (code, out, err.count("\n")) == (2, "", 1)
            assert expected in err
    assert sorted(here.iterdir()) == before
    assert (here / "there.yaml").read_text() == "mine"
    assert program("model", "1", "--to", "yaml", "-o", "there.yaml", "--force")[0] == 0
    assert (here / "there.yaml").read_text().startswith("# identified model of run 1 ")


def test_a_failed_run_has_no_model(here: Path, program: Program) -> None:
    with sqlite3.connect(here / "results" / "results.db") as logbook:
        logbook.execute("DELETE FROM coefficient WHERE run_id = 1")
        logbook.execute("UPDATE run SET status = 'failed', error = 'x' WHERE id = 1")
    logbook.close()
    code, _, err = program("model", "1", "--to", "yaml")
    assert (code, err.count("\n")) == (2, 1)
    assert "run 1 (failed) has no model 'identified', expected a run that stored a model" in err
