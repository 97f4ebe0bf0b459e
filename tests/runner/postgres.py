"""A PostgreSQL server of the tests' own, on a free port of 127.0.0.1."""

import os
import pwd
import shutil
import signal
import socket
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pytest

PASSWORD = "anchor"
os.environ["PGPASSWORD"] = PASSWORD  # of the tests' own servers; addresses hold none
INSTALL = "apt-get install postgresql, and pip install 'psycopg[binary]'"


@dataclass
class Postgres:
    """A server of our own on a free port of 127.0.0.1."""

    port: int
    start: Callable[[int], subprocess.Popen[bytes]]
    process: subprocess.Popen[bytes]
    made: int = 0
    used: int = 0  # by the current test

    def new_database(self) -> str:
        """An empty database: a former test's, emptied, since making one takes 300 files."""
        import psycopg

        self.used += 1
        name = f"sea{self.used}"
        if self.used > self.made:
            with psycopg.connect(self.url("postgres"), autocommit=True) as connection:
                connection.execute(f"CREATE DATABASE {name}")
            self.made += 1
        else:
            with psycopg.connect(self.url(name), autocommit=True) as connection:
                connection.execute("DROP SCHEMA public CASCADE")
                connection.execute("CREATE SCHEMA public")
        return self.url(name)

    def leave(self) -> None:
        """End the server; what was committed is kept."""
        self.process.send_signal(signal.SIGINT)
        self.process.wait(30)

    def come_back(self) -> None:
        """Start it again, on the same port."""
        self.process = self.start(self.port)

    def url(self, database: str) -> str:
        return _url(self.port, database)


def _url(port: int, database: str) -> str:
    return f"postgresql://sailor@127.0.0.1:{port}/{database}"


def _binaries() -> Path | None:
    """The newest server's programs: Debian keeps them out of PATH."""
    found = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"),
                   key=lambda initdb: float(initdb.parent.parent.name))  # fmt: skip
    if found:
        return found[-1].parent
    if config := shutil.which("pg_config"):
        said = subprocess.run([config, "--bindir"], capture_output=True, text=True, check=True)
        if (folder := Path(said.stdout.strip())).joinpath("initdb").exists():
            return folder
    return None


def served(parent: Path | None = None) -> Iterator[Postgres]:
    """The server, while the tests run; they skip where it is not installed.

    Its files are below `parent`, which its account must be able to reach.
    """
    pytest.importorskip("psycopg", reason=f"no psycopg: {INSTALL}")
    binaries = _binaries()
    account = "postgres" if os.getuid() == 0 else None  # the server refuses root
    if binaries is None:
        pytest.skip(f"no PostgreSQL server: {INSTALL}")
    # Root's own temporary folder may be closed to the server's account.
    place = parent or ("/tmp" if account else None)
    folder = Path(tempfile.mkdtemp(prefix="seatrial-postgres-", dir=place))
    if account:
        owner = pwd.getpwnam(account)
        os.chown(folder, owner.pw_uid, owner.pw_gid)
    password = folder / "password"
    password.write_text(PASSWORD)
    password.chmod(0o644)
    try:
        make = (
            *(binaries / "initdb", "-D", folder / "data", "-U", "sailor", "-A", "scram-sha-256"),
            *("--pwfile", password, "--no-sync", "--encoding", "UTF8", "--locale", "C"),
        )
        subprocess.run(make, user=account, cwd=folder, check=True, capture_output=True)
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port: int = probe.getsockname()[1]
        start = partial(_start, binaries, folder, account)
        server = Postgres(port, start, start(port))
        try:
            yield server
        finally:
            server.process.send_signal(signal.SIGQUIT)  # at once: nothing of it is kept
            server.process.wait(30)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _start(binaries: Path, folder: Path, account: str | None, port: int) -> subprocess.Popen[bytes]:
    command = (
        *(binaries / "postgres", "-D", folder / "data", "-p", str(port)),
        *("-c", "listen_addresses=127.0.0.1", "-c", f"unix_socket_directories={folder}"),
        *("-c", "fsync=off", "-c", "max_connections=100"),
    )
    with (folder / "log").open("wb") as log:
        server = subprocess.Popen(command, user=account, cwd=folder, stdout=log, stderr=log)
    import psycopg

    url = _url(port, "postgres")
    for _ in range(200):
        try:
            psycopg.connect(url).close()
            return server
        except psycopg.OperationalError:
            assert server.poll() is None, (folder / "log").read_text()
            time.sleep(0.05)
    raise AssertionError((folder / "log").read_text())
