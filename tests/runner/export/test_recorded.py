"""A model identified from a measured recording is sailed, in its own trial and in another one."""

from pathlib import Path

import numpy as np
import pytest

from tests.runner.command import Command
from tests.runner.programs import rows

MASS, DAMPING = 50.0, 12.0
DEPLOYED = (
    "SELECT dof, name, value FROM metric WHERE run_id = {} AND stage = 'deployment' "
    "AND model = '{}' AND name NOT LIKE 'step_time%' ORDER BY id"
)
SAILED = ("evaluation=setpoints", "evaluation.duration_s=200", "controller=pid_ff")


@pytest.fixture
def measured(tmp_path: Path) -> tuple[str, ...]:
    """Options of a recording of a body that is pushed to and fro ahead: 50 kg, 12 kg/s."""
    h, t = 0.1, 0.1 * np.arange(600)
    force = 10.0 * np.sign(np.sin(0.7 * t)) + 5.0 * np.sign(np.sin(0.23 * t))
    decay = np.exp(-DAMPING / MASS * h)
    speed, place = np.zeros(len(t)), np.zeros(len(t))
    for k in range(len(t) - 1):  # exact for a force that is held
        speed[k + 1] = decay * speed[k] + (1.0 - decay) * force[k] / DAMPING
        place[k + 1] = place[k] + 0.5 * h * (speed[k] + speed[k + 1])
    lines = ["Time,position_x,surge_vel,force_x"]
    lines += [
        ",".join(map(repr, map(float, row))) for row in zip(t, -place, speed, force, strict=True)
    ]  # the map of the file's columns turns the position
    (tmp_path / "measured.csv").write_text("\n".join(lines) + "\n")
    return ("vessel=surge_linear", "excitation=recording", "excitation.path=measured.csv")


def sailed(seatrial: Command, *words: str) -> None:
    answer = seatrial(*words)
    assert answer.code == 0, answer


def note(folder: Path, run: int) -> str:
    ((text,),) = rows(folder, f"SELECT note FROM run WHERE id = {run}")
    return str(text)


def test_the_identified_model_is_the_plant(
    seatrial: Command, tmp_path: Path, measured: tuple[str, ...]
) -> None:
    sailed(seatrial, *measured, "identifier=ls", "identifier.basis=physical", *SAILED)
    assert note(tmp_path, 1).endswith("the plant of the deployment is the identified model")
    # The same vessel, controller and mission in a trial of its own, without a recording.
    sailed(seatrial, "vessel=run:1", "excitation=prbs", "identifier=none", *SAILED)
    first = rows(tmp_path, DEPLOYED.format(1, "identified"))
    again = rows(tmp_path, DEPLOYED.format(2, "nominal"))
    assert len(first) > 10
    assert first == again
    nominal = rows(tmp_path, DEPLOYED.format(1, "nominal"))
    assert nominal != first  # 60 kg and 20 kg/s in its feedforward


def test_a_model_is_no_stranger_to_what_it_was_regressed_on(
    seatrial: Command, tmp_path: Path, measured: tuple[str, ...]
) -> None:
    """The identified model of a run, and a vessel that says so; the nominal one is a stranger."""
    vessel, *file = measured
    (tmp_path / "runs").mkdir()
    shorter = (tmp_path / "measured.csv").read_text().splitlines()[:-1]
    (tmp_path / "runs" / "other.csv").write_text("\n".join(shorter) + "\n")
    other = (*file[:1], "excitation.path=runs/other.csv")
    said = "was itself regressed on {}: it is no stranger to"
    for words, name in (
        ((vessel, *file), ""),
        (("vessel=run:1", *file), "measured.csv"),
        (("vessel=run:1", *other), ""),
        ((vessel, *other, "+vessel.regressed_on=[runs/*.csv]"), "other.csv"),
    ):
        answer = seatrial(*words, "identifier=ls", "evaluation=none")
        assert answer.code == 0
        assert ("was itself regressed on" in answer.err) == bool(name)
        assert said.format(name) in answer.err or not name
    query = "SELECT run_id, label FROM diagnostic WHERE name = 'recording_believed' ORDER BY run_id"
    assert rows(tmp_path, query) == [(2, "measured.csv"), (4, "other.csv")]


def test_the_plant_is_not_scaled(
    seatrial: Command, tmp_path: Path, measured: tuple[str, ...]
) -> None:
    for scale in ("1.0", "0.5"):
        sailed(seatrial, *measured, "identifier=ls", f"plant.scale={scale}", *SAILED)
    found = [rows(tmp_path, DEPLOYED.format(run, "identified")) for run in (1, 2)]
    assert found[0] == found[1]


def test_without_an_evaluation_of_its_own_nothing_is_sailed(
    seatrial: Command, tmp_path: Path, measured: tuple[str, ...]
) -> None:
    options = ((), ("evaluation=none",), ("controller=none", *SAILED[:2]))
    for run, words in enumerate(options, start=1):
        sailed(seatrial, *measured, "identifier=ls", *words)
        said = "measured recording: plant simulation and deployment are skipped"
        assert note(tmp_path, run) == said
        assert rows(tmp_path, DEPLOYED.format(run, "identified")) == []


def test_a_model_that_cannot_be_simulated_is_kept(
    seatrial: Command, tmp_path: Path, measured: tuple[str, ...]
) -> None:
    """Pushed ahead it goes astern: its mass is negative."""
    file = tmp_path / "measured.csv"
    head, *lines = file.read_text().splitlines()
    turned = [",".join([*line.split(",")[:3], repr(-float(line.split(",")[3]))]) for line in lines]
    file.write_text("\n".join([head, *turned]) + "\n")
    free = ("identifier=ls", "identifier.inertia_factor=null", "deploy_unphysical=true")
    sailed(seatrial, *measured, *free, *SAILED)
    assert "deployment is skipped: " in note(tmp_path, 1)
    assert "the inertia matrix must be positive definite" in note(tmp_path, 1)
    query = "SELECT value FROM coefficient WHERE model = 'identified' AND term = 'u_dot'"
    ((mass,),) = rows(tmp_path, query)
    assert isinstance(mass, float)
    assert mass < 0.0


def test_an_evaluation_that_does_not_suit_is_one_line(
    seatrial: Command, measured: tuple[str, ...]
) -> None:
    answer = seatrial(*measured, "evaluation=operation")
    assert (answer.code, answer.out, answer.err.count("\n")) == (2, "", 1)
    assert "evaluation=operation" in answer.err
