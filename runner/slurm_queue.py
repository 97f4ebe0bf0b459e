"""The state of Slurm's jobs, from the controller's queue; needs the extra `slurm`.

submitit asks the accounting (`sacct`). A Slurm without accounting never says that a job has ended,
so a sweep that lost one would wait for ever; one with accounting is asked every ten minutes only.
`squeue` answers everywhere.
"""

from submitit.slurm.slurm import SlurmInfoWatcher, SlurmJob

EVERY_S = 60  # at most between two questions; after a submission the first come sooner
# squeue(1), JOB STATE CODES: what a job does not leave by itself. A preempted one may be queued
# again; where it is not, it drops out of the queue.
ENDED = {
    "BOOT_FAIL",
    "CANCELLED",
    "COMPLETED",
    "DEADLINE",
    "FAILED",
    "NODE_FAIL",
    "OUT_OF_MEMORY",
    "TIMEOUT",
}
FORGOTTEN = "FORGOTTEN"  # ended longer ago than Slurm remembers (MinJobAge, five minutes)


class QueueWatcher(SlurmInfoWatcher):
    """Asks squeue for all of the user's jobs at once, those that ended of late among them."""

    def _make_command(self) -> list[str] | None:
        if not self._registered - self._finished:
            return None
        return ["squeue", "--me", "--array", "--noheader", "--states=all", "--format=%i|%T|%N"]

    def read_info(self, string: bytes | str) -> dict[str, dict[str, str]]:
        """State and nodes of each job that was submitted, from the answer of squeue."""
        answer = string if isinstance(string, str) else string.decode()
        listed = dict.fromkeys(self._registered, (FORGOTTEN, ""))
        for line in answer.splitlines():
            job, state, nodes = line.strip().split("|")
            listed[job] = (state, nodes)
        return {job: {"State": state, "NodeList": nodes} for job, (state, nodes) in listed.items()}

    def is_done(self, job_id: str, mode: str = "standard") -> bool:
        """Whether a job has ended, however it did."""
        return self.get_state(job_id, mode) in {*ENDED, FORGOTTEN}


def watch_the_queue() -> None:
    """Let submitit learn from the queue what becomes of its jobs."""
    SlurmJob.watcher = QueueWatcher(delay_s=EVERY_S)
