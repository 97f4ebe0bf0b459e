"""The state of Slurm jobs from the queue (`squeue`); needs the extra `slurm`.

submitit reads the accounting (`sacct`), every ten minutes only. Without accounting it never learns
that a job has ended, so a sweep with a lost job would wait for ever. `squeue` works on every
cluster.
"""

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager

from submitit.slurm.slurm import SlurmInfoWatcher, SlurmJob

EVERY_S = 60  # longest time [s] between two queries; shorter after a submission
# squeue(1), JOB STATE CODES: the final states. A preempted job is either queued again, or
# disappears from the queue.
ENDED = {
    *("BOOT_FAIL", "CANCELLED", "COMPLETED", "DEADLINE", "FAILED", "NODE_FAIL", "OUT_OF_MEMORY"),
    "TIMEOUT",
}
FORGOTTEN = "FORGOTTEN"  # ended longer ago than Slurm remembers (MinJobAge, five minutes)


class QueueWatcher(SlurmInfoWatcher):
    """Queries squeue for all jobs of the user at once, including those that ended recently."""

    def __init__(self) -> None:
        super().__init__(delay_s=EVERY_S)
        self.jobs: set[str] = set()

    def register_job(self, job_id: str) -> None:
        """Watch a job."""
        super().register_job(job_id)
        self.jobs.add(job_id)

    def _make_command(self) -> list[str]:
        return ["squeue", "--me", "--array", "--noheader", "--states=all", "--format=%i|%T|%N"]

    def read_info(self, string: bytes | str) -> dict[str, dict[str, str]]:
        """Return the state and nodes of each watched job, from the output of squeue."""
        answer = string if isinstance(string, str) else string.decode()
        listed = dict.fromkeys(self.jobs, (FORGOTTEN, ""))
        for line in answer.splitlines():
            job, state, nodes = line.strip().split("|")
            listed[job] = (state, nodes)
        return {job: {"State": state, "NodeList": nodes} for job, (state, nodes) in listed.items()}

    def is_done(self, job_id: str, mode: str = "standard") -> bool:
        """Return whether a job has ended, successfully or not."""
        return self.get_state(job_id, mode) in {*ENDED, FORGOTTEN}


@contextmanager
def watched_queue() -> Iterator[None]:
    """Make submitit read the state of its jobs from the queue; cancel them if the block fails."""
    SlurmJob.watcher = watcher = QueueWatcher()
    try:
        yield
    except BaseException:
        if watcher.jobs:
            subprocess.run(["scancel", "--quiet", *watcher.jobs], check=False)
        raise
