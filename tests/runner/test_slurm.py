"""What becomes of Slurm's jobs, learnt from the queue: no accounting is asked."""

import signal
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

pytest.importorskip("submitit", reason="no submitit: pip install -e '.[slurm]'")
from seatrial.runner.database import LogbookWriter
from seatrial.runner.sweeps.slurm_queue import QueueWatcher
from tests.runner.programs import ended, program, rows, wait
from tests.runner.slurm import Slurm

Answer = Callable[[str], None]
# squeue(1), JOB STATE CODES, those of a job that is, or may come to be, under way again.
UNDER_WAY = (
    *("COMPLETING", "CONFIGURING", "PENDING", "PREEMPTED", "RUNNING", "REQUEUED", "REQUEUE_FED"),
    *("REQUEUE_HOLD", "RESIZING", "RESV_DEL_HOLD", "SIGNALING", "SPECIAL_EXIT", "STAGE_OUT"),
    *("STOPPED", "SUSPENDED"),
)
OVER = (
    *("BOOT_FAIL", "CANCELLED", "COMPLETED", "DEADLINE", "FAILED", "NODE_FAIL", "OUT_OF_MEMORY"),
    "TIMEOUT",
)


@pytest.fixture
def squeue(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Answer:
    """Sets what squeue answers; where it is empty, squeue fails."""
    program = tmp_path / "squeue"

    def answer(said: str) -> None:
        program.write_text(f"#!/bin/sh\necho '{said}'\n" if said else "#!/bin/sh\nexit 1\n")
        program.chmod(0o755)

    monkeypatch.setenv("PATH", str(tmp_path))
    return answer


@pytest.mark.parametrize("mode", ["under way", "over"])
def test_a_job_is_waited_for_while_it_may_end_by_itself(mode: str, squeue: Answer) -> None:
    for state in OVER if mode == "over" else UNDER_WAY:
        squeue(f"6|RUNNING|sea\n7_0|{state}|sea\n7_1|RUNNING|sea")
        watcher = QueueWatcher()
        assert watcher.is_done("7_0", mode="force") is (mode == "over"), state
        assert watcher.get_state("7_0") == state
        assert not watcher.is_done("7_1", mode="force")


def test_what_the_queue_has_forgotten_has_ended_but_no_answer_is_not_an_end(squeue: Answer) -> None:
    squeue("8|RUNNING|sea")
    assert QueueWatcher().is_done("7", mode="force")
    squeue("")
    assert not QueueWatcher().is_done("7", mode="force")


@pytest.mark.slow
def test_the_queue_of_a_real_slurm(slurm: Slurm, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in slurm.variables.items():
        monkeypatch.setenv(name, value)
    monkeypatch.chdir(slurm.folder)
    script = "#!/bin/sh\n[ $SLURM_ARRAY_TASK_ID = 0 ] || sleep 600\n"
    command = ["sbatch", "--parsable", "--array=0-2%2"]  # the third waits for its turn
    job = subprocess.run(command, input=script, capture_output=True, text=True, check=True)
    one, two, three = (f"{job.stdout.strip()}_{number}" for number in range(3))
    watcher = QueueWatcher()
    for each in (one, two, three):
        watcher.register_job(each)
    slurm.wait(lambda: watcher.is_done(one, mode="force"))
    assert not watcher.is_done(two, mode="force")
    assert not watcher.is_done(three, mode="force")
    slurm.ask("scancel", two)
    slurm.wait(lambda: watcher.is_done(two, mode="force"))
    assert watcher.get_state(two) == "CANCELLED"
    slurm.wait(lambda: watcher.get_state(three, mode="force") == "RUNNING")
    slurm.ask("scancel", three)


@pytest.mark.slow
def test_the_jobs_of_a_sweep_that_is_stopped_are_cancelled(slurm: Slurm, tmp_path: Path) -> None:
    """Three jobs of many minutes, of which the third waits for its turn."""
    search = ("identifier=nsga2", "identifier.population=5000", "identifier.generations=5000")
    options = ("hydra/launcher=submitit_slurm", "hydra.launcher.partition=short", "seed=0,1,2")
    words = ("-m", "runner", "-m", *search, *options, "evaluation=none")
    process = program(*words, folder=tmp_path, **slurm.variables)
    wait(lambda: rows(tmp_path, "SELECT id FROM run") or process.poll() is not None)
    process.send_signal(signal.SIGTERM)
    code, _, err = ended(process)
    assert code == 143, err
    assert err.splitlines()[-1].startswith("seatrial: interrupted")
    slurm.wait(lambda: not slurm.ask("squeue", "--me", "--noheader"))
    logbook = LogbookWriter.read(f"sqlite:///{tmp_path}/results/results.db", results_dir=tmp_path)
    with logbook:
        assert {run.status for run in logbook.runs()} == {"interrupted"}
