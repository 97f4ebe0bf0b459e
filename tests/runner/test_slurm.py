"""What becomes of Slurm's jobs, learnt from the queue: no accounting is asked."""

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

pytest.importorskip("submitit", reason="no submitit: pip install -e '.[slurm]'")
from seatrial.runner.slurm_queue import QueueWatcher
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


@pytest.mark.parametrize("state", UNDER_WAY)
def test_a_job_is_waited_for_while_it_may_end_by_itself(state: str, squeue: Answer) -> None:
    squeue(f"7_0|{state}|sea")
    assert not QueueWatcher().is_done("7_0", mode="force")


@pytest.mark.parametrize("state", OVER)
def test_a_job_that_has_ended_is_not_waited_for(state: str, squeue: Answer) -> None:
    squeue(f"6|RUNNING|sea\n7_0|{state}|sea\n7_1|RUNNING|sea")
    watcher = QueueWatcher()
    assert watcher.is_done("7_0", mode="force")
    assert watcher.get_state("7_0") == state
    assert not watcher.is_done("7_1", mode="force")


def test_what_the_queue_has_forgotten_has_ended(squeue: Answer) -> None:
    squeue("8|RUNNING|sea")
    assert QueueWatcher().is_done("7", mode="force")


def test_no_answer_is_not_an_end(squeue: Answer) -> None:
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
