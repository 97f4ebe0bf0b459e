"""A Slurm of the tests' own: one node, which is this machine, on free ports of 127.0.0.1."""

import getpass
import os
import secrets
import shutil
import signal
import socket
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from tests.runner.programs import belonging_to

INSTALL = "apt-get install slurmctld slurmd slurm-client munge"
PROGRAMS = ("munged", "slurmctld", "slurmd", "srun", "sbatch", "squeue", "sinfo", "scancel")
# Daemons are in /usr/sbin, which is not in every user's PATH.
PATH = os.pathsep.join([os.environ.get("PATH", ""), "/usr/sbin", "/sbin"])
WAIT_S = 60.0

# No accounting, no cgroups, two processors whatever the machine has; the daemons listen on the
# loopback interface only.
CONFIGURATION = """\
ClusterName=seatrial
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={controller_port}
SlurmdPort={node_port}
CommunicationParameters=NoInAddrAny,NoCtldInAddrAny
SlurmUser={user}
SlurmdUser={user}
AuthType=auth/munge
AuthInfo=socket={folder}/munge
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
SlurmdParameters=config_overrides
ReturnToService=2
MpiDefault=none
NodeName={host} NodeAddr=127.0.0.1 CPUs=2 State=UNKNOWN
PartitionName=short Nodes=ALL Default=YES State=UP
"""


@dataclass
class Slurm:
    """A running controller with one node of two processors, in partition `short`."""

    folder: Path
    daemons: list[subprocess.Popen[bytes]] = field(default_factory=list)

    @property
    def variables(self) -> dict[str, str]:
        """What tells a program of this Slurm."""
        return {"SLURM_CONF": str(self.folder / "slurm.conf"), "PATH": PATH}

    def ask(self, *command: str) -> str:
        """The answer of one of Slurm's programs; nothing where it fails."""
        environment = {**os.environ, **self.variables}
        said = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        return said.stdout.strip() if said.returncode == 0 else ""

    def logs(self) -> str:
        """What the daemons have said."""
        return "\n".join(log.read_text() for log in sorted(self.folder.glob("*.log")))

    def start(self, *command: str) -> None:
        """Start a daemon in the foreground, as a child that does not outlive the tests."""
        program = shutil.which(command[0], path=PATH)
        assert program is not None
        tied = ("setpriv", "--pdeathsig", "KILL", "--")
        with (self.folder / f"{command[0]}.log").open("wb") as log:
            daemon = subprocess.Popen(
                [*tied, program, *command[1:]], env={**os.environ, **self.variables},
                cwd=self.folder, stdin=subprocess.DEVNULL, stdout=log, stderr=log,
                start_new_session=True,
            )  # fmt: skip
        self.daemons.append(daemon)

    def wait(self, ready: Callable[[], object]) -> None:
        """Wait for the daemons to get something done."""
        deadline = time.monotonic() + WAIT_S
        while not ready():
            ended = any(daemon.poll() is not None for daemon in self.daemons)
            assert not ended and time.monotonic() < deadline, self.logs()  # noqa: PT018
            time.sleep(0.1)

    def stop(self) -> None:
        """End the jobs, then the daemons, those first that need the others."""
        try:
            self.ask("scancel", "--me", "--signal=KILL", "--full")
            self.wait(lambda: not self.ask("squeue", "--me", "--noheader"))
            while self.daemons:
                self.daemons[-1].terminate()
                self.daemons.pop().wait(WAIT_S)
        finally:  # and what is left of them, or of a sweep whose test has failed
            for pid in belonging_to(f"SLURM_CONF={self.variables['SLURM_CONF']}"):
                os.kill(pid, signal.SIGKILL)


def served() -> Iterator[Slurm]:
    """The cluster, while the tests run; they skip where it is not installed."""
    absent = [name for name in (*PROGRAMS, "setpriv") if shutil.which(name, path=PATH) is None]
    if absent:
        pytest.skip(f"no Slurm here ({', '.join(absent)}): {INSTALL}")
    with _started() as slurm:
        yield slurm


@contextmanager
def _started() -> Iterator[Slurm]:
    # Short, for the path of a socket is; and open, since munged wants its socket to be reached.
    folder = Path(tempfile.mkdtemp(prefix="seatrial-slurm-", dir="/tmp"))
    slurm = Slurm(folder)
    try:
        _prepare(folder)
        files = ("key-file", "munge.key"), ("pid-file", "munged.pid"), ("seed-file", "munged.seed")
        paths = [f"--{option}={folder / name}" for option, name in files]
        try:
            slurm.start("munged", "--foreground", f"--socket={folder}/munge", *paths)
            slurm.wait((folder / "munge").exists)
            slurm.start("slurmctld", "-D")
            slurm.start("slurmd", "-D")
            slurm.wait(lambda: slurm.ask("sinfo", "--noheader", "--format=%T") == "idle")
            yield slurm
        finally:
            slurm.stop()
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _prepare(folder: Path) -> None:
    folder.chmod(0o755)
    for name in ("state", "spool"):
        (folder / name).mkdir()
    key = folder / "munge.key"
    key.touch(mode=0o600)
    key.write_bytes(secrets.token_bytes(128))
    names = {"host": socket.gethostname().partition(".")[0], "user": getpass.getuser()}
    with socket.socket() as one, socket.socket() as other:  # free ports
        one.bind(("127.0.0.1", 0))
        other.bind(("127.0.0.1", 0))
        ports = {"controller_port": one.getsockname()[1], "node_port": other.getsockname()[1]}
    (folder / "slurm.conf").write_text(CONFIGURATION.format(folder=folder, **names, **ports))
